"""Parts by name: what is found, what is imported for it, and what is said of names that are none."""

from __future__ import annotations

import copy
import subprocess
import sys

import pytest

from activelsd import registry
from activelsd.envs.modelnet.settings import ModelNetSettings
from activelsd.policy.settings import AlexNetSettings
from activelsd.registry import Registry, UnknownPartError

KINDS = registry.ALL


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.group)
def test_every_own_part_is_there(kind: Registry) -> None:
    assert kind.names()[: len(kind.own())] == kind.own()
    for name in kind.own():
        assert kind.get(name) is not None
        assert kind.package(name) is None, "it is this package's"


def test_the_kinds_are_those_of_the_documented_groups() -> None:
    parts = ("trunks", "memories", "terms", "figures", "loggers")
    groups = ("worlds", "orbit_moves", "players", "stops", "recognisers", *parts)
    assert [kind.group for kind in KINDS] == list(groups)


def test_nothing_is_imported_until_a_part_is_asked_for() -> None:
    code = (
        "import sys; from activelsd import registry\n"
        "registry.trunks.names(), registry.trunks.check('compact'), registry.trunks.settings('alexnet')\n"
        "print(sorted({'torch', 'numpy', 'gymnasium'} & set(sys.modules)))\n"
        "registry.trunks.get('compact'); print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[:2] == ["[]", "True"]


def test_an_unknown_name_gets_the_nearest_also_from_another_process() -> None:
    with pytest.raises(UnknownPartError, match=r"^There is no memory 'lst'; did you mean lstm\?$") as error:
        registry.memories.get("lst")
    again = copy.copy(error.value)  # by __reduce__, as Ray sends it
    assert (str(again), again.kind, again.name) == (str(error.value), "memory", "lst")
    with pytest.raises(
        UnknownPartError, match=r"^There is no trunk 'zzz' \(in f\); there are compact, alexnet, timm:NAME\.$"
    ):
        registry.trunks.check("zzz", " (in f)")


def test_parts_are_added_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry.trunks, "_added", {})
    registry.trunks.add("mine", AlexNetSettings)
    assert registry.trunks.get("mine") is AlexNetSettings
    assert registry.trunks.names() == ["compact", "alexnet", "timm:NAME", "mine"]
    assert registry.trunks.name_of(AlexNetSettings) == "mine"


def test_a_class_knows_its_name_and_a_part_its_settings() -> None:
    assert registry.worlds.name_of(ModelNetSettings) == "modelnet"
    assert registry.worlds.name_of(AlexNetSettings) is None
    assert registry.trunks.settings("alexnet") is AlexNetSettings
    assert registry.trunks.settings("compact") is None


def test_a_family_has_a_part_for_every_name() -> None:
    one = registry.trunks.get("timm:resnet18")
    assert one.net_name == "resnet18"
    assert registry.trunks.settings("timm:resnet18").__name__ == "TimmSettings"
    assert registry.trunks.package("timm:resnet18") is None
    with pytest.raises(UnknownPartError, match=r"did you mean timm:NAME\?$"):
        registry.trunks.get("timm:")
