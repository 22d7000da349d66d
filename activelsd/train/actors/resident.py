"""Resident actors: recorded views, network and rollouts on one device; learning reuses the acting pass."""

from __future__ import annotations

from collections.abc import Sequence
from zlib import crc32

import torch
from torch import Tensor

from activelsd.envs.joint import JointVectorEnv, OpenWorld, play_recordings
from activelsd.envs.vector import Step, ViewGraphVectorEnv
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, Output, joined
from activelsd.policy.memories import split_state
from activelsd.train.actors.interface import MakeActors
from activelsd.train.augment import VARIATION_SIZE, Variation, kept
from activelsd.train.rollout import Rollout
from activelsd.train.settings import TrainSettings
from activelsd.train.terms import needs_nearer


class ResidentActors:
    """Plays B episodes side by side, L steps at a time.

    Nothing in a rollout waits for the device: actions are drawn and new episodes begun there.

    Attributes:
        generator: draws the actions, on the device.
    """

    def __init__(
        self,
        env: ViewGraphVectorEnv | JointVectorEnv,
        network: LSDNet,
        length: int,
        seed: int,
        *,
        vary_crops: bool = False,
        mirror: bool = False,
        dropout: float = 0.0,
        nearer: bool = False,
    ) -> None:
        """Start B episodes; `seed` fixes which, and how actions and variations are drawn.

        Crops vary and episodes are mirrored as in `Variation`. At every view a share `dropout` of the
        memory's outputs is dropped in acting and learning, but not for bootstrap values. With `nearer`,
        rollouts say which moves lead nearer to a good look.

        Raises:
            ConfigError: episodes are to be mirrored, and a move has no opposite.
        """
        self.env, self.network, self.length = env, network, length
        self._dropout, self._nearer = dropout, nearer
        self.places = env.places if isinstance(env, JointVectorEnv) else {}
        self.generator = torch.Generator(env.device).manual_seed(seed)
        parts = list(env.parts.values()) if isinstance(env, JointVectorEnv) else [env]
        trees = [part.tree for part in parts]
        crops = vary_crops and network.shape.crops
        self._variation = Variation(trees, env.tree, torch.device(env.device), crops=crops, mirror=mirror)
        self._variations = torch.zeros(env.num_envs, VARIATION_SIZE, device=env.device)
        env.begin(seed)
        if nearer:
            env.nearer()  # shortest ways are computed now, and not during a rollout
        self._memory = network.initial_state(env.num_envs)
        self._first = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)

    def collect(self, epsilon: Epsilon) -> Rollout:
        """Play L steps with this much random exploration."""
        env, memory, vary = self.env, self._memory, self._variation
        seen: list[dict[str, Tensor]] = []
        masks, labels, firsts, actions, nearer = [], [], [], [], list[Tensor]()
        outputs: list[Output] = []
        steps: list[Step] = []
        for _ in range(self.length):
            observation = self._dropped(self._look())
            mask = vary.mask(env.mask(), self._variations)
            output = self.network(_one(observation), memory, self._first[None])
            drawn = self.network.distribution(output.logits[0].detach(), mask, epsilon)
            action = drawn.sample(self.generator)
            seen.append(observation)
            masks.append(mask)
            labels.append(env.labels)
            if self._nearer:
                nearer.append(vary.mask(env.nearer(), self._variations))
            firsts.append(self._first)
            actions.append(action)
            outputs.append(output)
            step = env.advance(vary.actions(action, self._variations))
            steps.append(step)
            memory, self._first = output.state, step.terminated | step.truncated
        before, self._memory = self._memory, {name: x.detach() for name, x in memory.items()}
        return Rollout(
            observation={name: torch.stack([o[name] for o in seen]) for name in seen[0]},
            first=torch.stack(firsts),
            mask=torch.stack(masks),
            labels=torch.stack(labels),
            state=before,
            actions=torch.stack(actions),
            epsilon=epsilon,
            rewards=torch.stack([s.reward for s in steps]),
            terminated=torch.stack([s.terminated for s in steps]),
            truncated=torch.stack([s.truncated for s in steps]),
            right=torch.stack([s.answer for s in steps]) == torch.stack(labels),
            views=torch.stack([s.views for s in steps]),
            bootstrap=self._bootstrap(),
            nearer=torch.stack(nearer) if nearer else None,
            output=joined(outputs)._replace(state=self._memory),
        )

    @torch.no_grad()
    def _bootstrap(self) -> Tensor:
        """(B,) values of the states after the last step; 0 or any value where an episode ended, unused."""
        seen, first = self._look(), self._first
        value = torch.zeros_like(first, dtype=torch.float32)
        rows = torch.arange(len(first), device=first.device)
        if first.is_cpu:  # on other devices, finding these rows would wait for the device
            rows = rows[~first]
        if len(rows):
            observation = {name: x.index_select(0, rows) for name, x in seen.items()}
            state = {name: x[rows] for name, x in self._memory.items()}
            output: Output = self.network(_one(observation), state, first[None, rows])
            value[rows] = output.value[0]
        return value

    def _look(self) -> dict[str, Tensor]:
        """The observation, augmented."""
        self._variations = self._variation.draw(self._variations, self._first, self.generator)
        return self._variation.look(self.env.observe(), self._variations)

    def _dropped(self, observation: dict[str, Tensor]) -> dict[str, Tensor]:
        """The observation with dropout's factors, if there is dropout."""
        if not self._dropout:
            return observation
        shape = (self.env.num_envs, self.network.memory.outputs)
        return observation | {"dropout": kept(shape, self._dropout, self.generator)}

    def measures(self) -> dict[str, float]:
        """Nothing: rollouts hold all there is."""
        return {}

    def close(self) -> None:
        """Does nothing: nothing was started."""

    def state(self) -> dict[str, Tensor]:
        """Episodes and generator, for a checkpoint."""
        return self.episodes() | {"generator": self.generator.get_state()}

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave; on another kind of device other actions are drawn from here on."""
        drawn = tensors["generator"]
        if drawn.shape == self.generator.get_state().shape:
            self.generator.set_state(drawn)
        else:  # each kind of device has its own generators
            self.generator.manual_seed(crc32(drawn.numpy().tobytes()))
        episodes = {k: v.to(self.env.device) for k, v in tensors.items() if k != "generator"}
        if "memory" in episodes:  # written by an older version: the state's tensors side by side
            parts = split_state(episodes.pop("memory"), self._memory)
            episodes |= {f"memory/{name}": part for name, part in parts.items()}
        self.set_episodes(episodes)

    def episodes(self) -> dict[str, Tensor]:
        """Every episode's state in the environments and in the memory, on the device."""
        # Checkpoints of older versions call the variations "draws".
        own = {"first": self._first, "draws": self._variations}
        own |= {f"memory/{name}": value for name, value in self._memory.items()}
        return own | {f"env/{name}": value for name, value in self.env.state().items()}

    def set_episodes(self, episodes: dict[str, Tensor]) -> None:
        """Continue from what `episodes` gave."""
        self._first, self._variations = episodes["first"], episodes["draws"]
        self._memory = {name: episodes[f"memory/{name}"] for name in self._memory}
        self.env.load_state({k.removeprefix("env/"): v for k, v in episodes.items() if k.startswith("env/")})


def on_recordings(
    worlds: Sequence[OpenWorld], settings: TrainSettings, *, frames: int, device: str = "cpu"
) -> MakeActors:
    """Actors for the training episodes of one world, or of several side by side; K = `frames` are stacked."""

    def make(network: LSDNet, seed: int) -> ResidentActors:
        recorded = worlds[0].graph.features is not None
        pictures = network.pictures if recorded else ("frames", "crops")
        env = play_recordings(worlds, num_envs=settings.envs, frames=frames, device=device, pictures=pictures)
        return ResidentActors(
            env,
            network,
            settings.length,
            seed,
            vary_crops=settings.vary_crops,
            mirror=settings.mirror,
            dropout=settings.dropout,
            nearer=needs_nearer(settings.terms),
        )

    return make


def _one(observation: dict[str, Tensor]) -> dict[str, Tensor]:
    """(B, ...) as one step (1, B, ...)."""
    return {name: value[None] for name, value in observation.items()}
