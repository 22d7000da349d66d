"""The network: the paper's layers, memories against episodes run one by one, files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from activelsd import registry
from activelsd.envs.actions import ActionTree
from activelsd.errors import ConfigError, RunError
from activelsd.policy.checkpoint import MEANING, WEIGHTS, load_network, save_network
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.policy.memories import Memory, State, cleared
from activelsd.policy.trunks import AlexNet, Blocks, as_input

TREE = ActionTree.answer_or_move(["a", "b", "c"], ["left", "right"])


def network(**shape: object) -> LSDNet:
    torch.manual_seed(0)
    chosen = {"size": 32, "trunk_settings": {"features": 16}} | shape
    return LSDNet(TREE, NetworkShape(**chosen))  # type: ignore[arg-type]


def observed(length: int, batch: int, frames: int = 1, *, crops: bool = False) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(1)
    shape = (length, batch, frames, 32, 32)
    pictures = torch.randint(0, 256, shape, generator=generator, dtype=torch.uint8)
    observation = {"frames": pictures, "target": torch.rand(length, batch, frames, 5, generator=generator)}
    return observation | ({"crops": pictures.flip(-1)} if crops else {})


def test_alexnet_has_the_papers_layers() -> None:
    """Section 3.2 and Figure 2, at 224 pixels with three frames."""
    trunk = AlexNet(3, 224)
    convolutions = [layer for layer in trunk.convolutions if isinstance(layer, nn.Conv2d)]
    assert [(c.out_channels, c.kernel_size[0], c.stride[0]) for c in convolutions] == [
        (64, 11, 4),
        (256, 5, 1),
        (384, 3, 1),
        (384, 3, 1),
        (256, 3, 1),
    ]
    assert convolutions[0].in_channels == 3
    assert [layer.out_features for layer in trunk.dense if isinstance(layer, nn.Linear)] == [4096, 4096]
    with torch.no_grad():
        features = trunk(torch.zeros(1, 3, 224, 224, dtype=torch.uint8))
    assert features.shape == (1, 4096)
    assert (features >= 0).all()


def test_alexnet_begins_as_ga3cs_networks_do() -> None:
    """Weights and biases uniform in plus and minus 1 / sqrt(inputs of a unit)."""
    torch.manual_seed(0)
    for layer in AlexNet(3, 63).modules():
        if isinstance(layer, nn.Conv2d | nn.Linear):
            bound = layer.weight[0].numel() ** -0.5
            assert layer.bias is not None
            for values in (layer.weight.detach(), layer.bias.detach()):
                assert 0.9 * bound < float(values.abs().max()) <= bound
                assert float(values.std()) == pytest.approx(bound / 3**0.5, rel=0.15)  # of a uniform one


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_blocks_are_pixels_unshuffled(channels: int, layout: torch.memory_format) -> None:
    frames = torch.randint(0, 256, (5, channels, 24, 16), dtype=torch.uint8).contiguous(memory_format=layout)
    expected = nn.PixelUnshuffle(4)(as_input(frames))
    for given in (frames, as_input(frames)):
        blocks = Blocks()(given)
        assert torch.equal(blocks, expected)
        assert blocks.is_contiguous(memory_format=torch.channels_last)


class Places(Memory):
    """The last views' features in a ring, and how many there were: a memory as another package may bring."""

    def __init__(self, features: int, places: int) -> None:
        super().__init__()
        self.places, self.outputs = places, places * features
        self.shapes = {"ring": (places, features), "seen": ()}

    def forward(self, features: Tensor, state: State, first: Tensor) -> tuple[Tensor, State]:
        outputs = []
        for x, begins in zip(features, first, strict=True):
            state = cleared(state, begins)
            here = functional.one_hot(state["seen"].long() % self.places, self.places)[..., None]
            state = {"ring": state["ring"] * (1 - here) + x[:, None] * here, "seen": state["seen"] + 1}
            outputs.append(state["ring"].flatten(1))
        return torch.stack(outputs), state


@pytest.fixture(autouse=True)
def _another_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry.memories, "_added", {"places": Places})


SETTINGS = {"places": {"places": 2}}


@pytest.mark.parametrize("memory", ["stack", "pool", "lstm", "places"])
@pytest.mark.parametrize("head", ["tree", "flat"])
@pytest.mark.parametrize("crops", [False, True])
def test_a_rollout_is_its_steps_one_after_another(memory: str, head: str, crops: bool) -> None:
    frames = 3 if memory == "stack" else 1
    own = SETTINGS.get(memory, {})
    net = network(memory=memory, memory_settings=own, head=head, frames=frames, crops=crops)
    observation = observed(5, 4, frames, crops=crops)
    first = torch.rand(5, 4, generator=torch.Generator().manual_seed(2)) < 0.3
    drawn = torch.Generator().manual_seed(3)
    start = {name: torch.rand(x.shape, generator=drawn).round() for name, x in net.initial_state(4).items()}
    with torch.no_grad():
        whole = net(observation, start, first)
        assert whole.logits.shape == (5, 4, TREE.n + (2 if head == "tree" else 0))
        assert whole.value.shape == (5, 4)
        assert whole.features.shape == (5, 4, net.trunk.features)
        assert whole.state.keys() == start.keys()
        # Every episode alone, every step alone, from where its memory was.
        for b in range(4):
            state = {name: x[b : b + 1] for name, x in start.items()}
            for t in range(5):
                one = {name: value[t : t + 1, b : b + 1] for name, value in observation.items()}
                if first[t, b]:
                    state = net.initial_state(1)
                alone = net(one, state, torch.zeros(1, 1, dtype=torch.bool))
                torch.testing.assert_close(alone.logits[0, 0], whole.logits[t, b])
                torch.testing.assert_close(alone.value[0, 0], whole.value[t, b])
                state = alone.state
            torch.testing.assert_close(
                {name: x[0] for name, x in state.items()}, {name: x[b] for name, x in whole.state.items()}
            )


def test_pool_does_not_mind_the_order_of_views_and_lstm_does() -> None:
    observation = observed(3, 1)
    swapped = {name: value[[1, 0, 2]] for name, value in observation.items()}
    first = torch.tensor([[True], [False], [False]])
    for memory, same in (("pool", True), ("lstm", False)):
        net = network(memory=memory)
        with torch.no_grad():
            a, b = (net(o, net.initial_state(1), first).logits[-1] for o in (observation, swapped))
        assert torch.allclose(a, b, atol=1e-6) == same


def test_first_policies_are_near_uniform_over_branches_and_leaves() -> None:
    net = network()
    mask = torch.ones(1, 6, TREE.n, dtype=torch.bool)
    with torch.no_grad():
        output = net(observed(1, 6), net.initial_state(6), torch.ones(1, 6, dtype=torch.bool))
    policy = net.distribution(output.logits, mask)
    assert (policy.branch_probs() - 0.5).abs().max() < 0.1


@pytest.mark.parametrize(
    ("shape", "sentence"),
    [
        ({"head": "bush"}, "There is no head 'bush'; choose tree or flat."),
        ({"memory": "diary"}, "There is no memory 'diary'; there are stack, lstm, pool, places."),
        ({"trunk": "elephant"}, "There is no trunk 'elephant'; there are compact, alexnet, timm:NAME."),
        ({"size": 33}, "policy.trunk=compact needs env.size to be a multiple of 4, not 33; set env.size=32."),
        (
            {"trunk": "alexnet", "trunk_settings": {}},
            "policy.trunk=alexnet needs env.size of at least 63 pixels, not 32; set env.size=224.",
        ),
    ],
)
def test_what_cannot_be_built_is_one_sentence(shape: dict[str, object], sentence: str) -> None:
    with pytest.raises(ConfigError) as error:
        network(**shape)
    assert str(error.value) == sentence


def test_a_network_survives_its_files(tmp_path: Path) -> None:
    net = network(memory="lstm", head="flat", frames=2)
    save_network(net, tmp_path)
    again = load_network(tmp_path)
    assert (again.tree, again.shape) == (net.tree, net.shape)
    for name, value in net.state_dict().items():
        assert torch.equal(value, again.state_dict()[name])
    assert json.loads((tmp_path / MEANING).read_text())["actions"] == TREE.to_dict()


def test_shapes_written_by_older_versions_are_read(tmp_path: Path) -> None:
    for trunk, settings in (("compact", {"features": 16}), ("alexnet", {})):
        net = network(trunk=trunk, trunk_settings=settings, size=64, memory="stack")
        save_network(net, tmp_path)
        meaning = json.loads((tmp_path / MEANING).read_text())
        del meaning["shape"]["trunk_settings"], meaning["shape"]["memory_settings"]
        del meaning["shape"]["channels"]  # all pictures were gray
        meaning["shape"]["features"] = 16
        (tmp_path / MEANING).write_text(json.dumps(meaning))
        assert load_network(tmp_path).shape == net.shape


def test_a_part_that_is_not_installed_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_network(network(memory="places", memory_settings={"places": 3}), tmp_path)
    assert load_network(tmp_path).memory.places == 3
    monkeypatch.setattr(registry.memories, "_added", {})
    with pytest.raises(RunError, match="names the memory 'places', which is not installed; install the pack"):
        load_network(tmp_path)


def test_broken_files_are_one_sentence(tmp_path: Path) -> None:
    save_network(network(), tmp_path)
    weights, meaning = (tmp_path / WEIGHTS).read_bytes(), (tmp_path / MEANING).read_text()
    (tmp_path / WEIGHTS).write_bytes(weights[: len(weights) // 2])
    with pytest.raises(RunError, match="cannot be read"):
        load_network(tmp_path)
    (tmp_path / WEIGHTS).write_bytes(weights)
    (tmp_path / MEANING).write_text(meaning.replace('"features": 16', '"features": 8'))
    with pytest.raises(RunError, match=f"does not fit the {MEANING} beside it"):
        load_network(tmp_path)
    (tmp_path / MEANING).write_text(meaning[:30])
    with pytest.raises(RunError, match="is not a network's description"):
        load_network(tmp_path)


def test_certainty_steers_by_the_classes_and_does_not_teach_them() -> None:
    plain, sure = network(), network(certainty=True)
    sure.load_state_dict(plain.state_dict(), strict=False)
    observation, first = observed(2, 3), torch.ones(2, 3, dtype=torch.bool)
    before = plain(observation, plain.initial_state(3), first)
    output = sure(observation, sure.initial_state(3), first)
    torch.testing.assert_close(output.logits, before.logits)  # it begins at zero
    assert sure.certainty is not None
    with torch.no_grad():
        sure.certainty.outputs.weight.fill_(1.0)
    output = sure(observation, sure.initial_state(3), first)
    branches, classes = len(TREE.branches), TREE.span("classify")
    named = slice(branches + classes.start, branches + classes.stop)
    torch.testing.assert_close(output.logits[..., named], before.logits[..., named])
    assert (output.logits[..., :branches] != before.logits[..., :branches]).all()
    output.logits[..., :branches].sum().backward()
    gradient = sure.policy.weight.grad
    assert gradient is not None
    assert not gradient[named].any()
    assert sure.certainty(torch.zeros(2, 1)).isfinite().all()  # of a single class one is sure
