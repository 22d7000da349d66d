"""Resident actors: recorded views, network and rollouts on one device, the acting pass kept for learning."""

from __future__ import annotations

from collections.abc import Sequence
from zlib import crc32

import torch
from torch import Tensor

from activelsd.envs.joint import JointVectorEnv, OpenWorld, play_recordings
from activelsd.envs.vector import Step, ViewGraphVectorEnv
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, Output
from activelsd.train.actors.interface import MakeActors
from activelsd.train.augment import VARIATION_SIZE, Variation, kept
from activelsd.train.rollout import Rollout
from activelsd.train.settings import TrainSettings


class ResidentActors:
    """Play B episodes side by side, L steps at a time.

    Nothing in a rollout waits for the device: actions are drawn and episodes replaced there.

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
        guided: bool = False,
    ) -> None:
        """Start B episodes; `seed` fixes which, how actions are drawn and, if asked for, how they vary.

        By `dropout` the network acts, and learns, with that share of its memory's features left out, each
        look with others; values that returns are built on are of all features. Where `guided`, rollouts say
        which moves lead nearer to a good look.
        """
        self.env, self.network, self.length = env, network, length
        self._dropout, self._guided = dropout, guided
        self.places = env.places if isinstance(env, JointVectorEnv) else {}
        self.generator = torch.Generator(env.device).manual_seed(seed)
        parts = list(env.parts.values()) if isinstance(env, JointVectorEnv) else [env]
        trees = [part.tree for part in parts]
        crops = vary_crops and network.shape.crops
        self._variation = Variation(trees, env.tree, torch.device(env.device), crops=crops, mirror=mirror)
        self._ways = torch.zeros(env.num_envs, VARIATION_SIZE, device=env.device)
        env.begin(seed)
        if guided:
            env.nearer()  # ways are found now, not in the midst of a rollout
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
            mask = vary.mask(env.mask(), self._ways)
            output = self.network(_one(observation), memory, self._first[None])
            drawn = self.network.distribution(output.logits[0].detach(), mask, epsilon)
            action = drawn.sample(self.generator)
            seen.append(observation)
            masks.append(mask)
            labels.append(env.labels)
            if self._guided:
                nearer.append(vary.mask(env.nearer(), self._ways))
            firsts.append(self._first)
            actions.append(action)
            outputs.append(output)
            step = env.advance(vary.actions(action, self._ways))
            steps.append(step)
            memory, self._first = output.state, step.terminated | step.truncated
        self._memory, before = memory.detach(), self._memory
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
            bootstrap=self._following(),
            nearer=torch.stack(nearer) if nearer else None,
            output=Output(
                torch.cat([o.logits for o in outputs]), torch.cat([o.value for o in outputs]), self._memory
            ),
        )

    @torch.no_grad()
    def _following(self) -> Tensor:
        """(B,) the value of what follows the last step, which nobody asks for where an episode ended."""
        seen, first = self._look(), self._first
        value = torch.zeros_like(first, dtype=torch.float32)
        rows = torch.arange(len(first), device=first.device)
        if first.is_cpu:  # elsewhere who goes on would have to be waited for
            rows = rows[~first]
        if len(rows):
            observation = {name: x.index_select(0, rows) for name, x in seen.items()}
            output: Output = self.network(_one(observation), self._memory[rows], first[None, rows])
            value[rows] = output.value[0]
        return value

    def _look(self) -> dict[str, Tensor]:
        """What is seen, varied."""
        self._ways = self._variation.ways(self._ways, self._first, self.generator)
        return self._variation.look(self.env.observe(), self._ways)

    def _dropped(self, observation: dict[str, Tensor]) -> dict[str, Tensor]:
        """The observation with the factors of the features that are kept, if any are to be left out."""
        if not self._dropout:
            return observation
        shape = (self.env.num_envs, self.network.memory.outputs)
        return observation | {"dropout": kept(shape, self._dropout, self.generator)}

    def measures(self) -> dict[str, float]:
        """Nothing beside what rollouts say."""
        return {}

    def close(self) -> None:
        """Nothing was started."""

    def state(self) -> dict[str, Tensor]:
        """What playing goes on from, for a checkpoint."""
        return self.episodes() | {"generator": self.generator.get_state()}

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave; on another kind of device actions are drawn otherwise from here on."""
        drawn = tensors["generator"]
        if drawn.shape == self.generator.get_state().shape:
            self.generator.set_state(drawn)
        else:  # each kind has generators of its own
            self.generator.manual_seed(crc32(drawn.numpy().tobytes()))
        self.go_on({k: v.to(self.env.device) for k, v in tensors.items() if k != "generator"})

    def episodes(self) -> dict[str, Tensor]:
        """Where every episode stands and what is remembered of it, on the device."""
        # "draws": by the name that it has in runs begun before.
        own = {"memory": self._memory, "first": self._first, "draws": self._ways}
        return own | {f"env/{name}": value for name, value in self.env.state().items()}

    def go_on(self, episodes: dict[str, Tensor]) -> None:
        """Play on from what `episodes` gave."""
        self._memory, self._first, self._ways = (episodes[name] for name in ("memory", "first", "draws"))
        self.env.load_state({k.removeprefix("env/"): v for k, v in episodes.items() if k.startswith("env/")})


def on_recordings(
    worlds: Sequence[OpenWorld], settings: TrainSettings, *, frames: int, device: str = "cpu"
) -> MakeActors:
    """Actors for the training episodes of one world, or of several side by side; K = `frames` are stacked."""

    def make(network: LSDNet, seed: int) -> ResidentActors:
        env = play_recordings(worlds, num_envs=settings.envs, frames=frames, device=device)
        return ResidentActors(
            env,
            network,
            settings.length,
            seed,
            vary_crops=settings.vary_crops,
            mirror=settings.mirror,
            dropout=settings.dropout,
            guided=settings.guided > 0,
        )

    return make


def _one(observation: dict[str, Tensor]) -> dict[str, Tensor]:
    """(B, ...) as one step (1, B, ...)."""
    return {name: value[None] for name, value in observation.items()}
