"""The digest of code finds what makes the pictures by itself, and does not mind how it is worded."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from activelsd.envs import digest
from activelsd.envs.digest import code_digest

WORLD = {
    "pictures.py": '"""Draws."""\nfrom my_world.deep import light\nGRAY = 3\n"""Of the walls."""\n',
    "deep/light.py": "def shade():\n    '''Late.'''\n    from ..inks import INK\n    return INK\n",
    "deep/__init__.py": "",
    "inks.py": "import my_world.paper as paper\nINK = 1\n",
    "paper.py": "import numpy\nWHITE = 255\n",
    "unrelated.py": "X = 1\n",
    "__init__.py": "from my_world import unrelated\n",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in WORLD.items():
        path = tmp_path / "my_world" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path / "my_world"


def fresh(*modules: str) -> str:
    code_digest.cache_clear()
    return code_digest(*modules)


@pytest.mark.parametrize("name", ["pictures.py", "deep/light.py", "inks.py", "paper.py"])
def test_every_module_that_is_reached_counts_and_its_wording_does_not(package: Path, name: str) -> None:
    before, path = fresh("my_world.pictures"), package / name
    text = path.read_text()
    path.write_text(
        f"# Said differently.\n{text.replace('Draws', 'Paints').replace('Of the', 'On')}\n'''More.'''\n"
    )
    assert fresh("my_world.pictures") == before
    path.write_text(text.replace("'''Late.'''", "'''Soon.'''"))
    assert fresh("my_world.pictures") == before
    path.write_text(f"{text}\nMORE = 1\n")
    assert fresh("my_world.pictures") != before
    path.write_text(text)
    assert fresh("my_world.pictures") == before


def test_what_is_not_reached_does_not_count(package: Path) -> None:
    before = fresh("my_world.pictures")
    (package / "unrelated.py").write_text("X = 2\n")
    assert fresh("my_world.pictures") == before
    assert fresh("my_world.pictures", "my_world.unrelated") != before


def test_a_module_that_is_not_there_is_an_error(package: Path) -> None:
    with pytest.raises(ModuleNotFoundError, match=r"no source of the module my_world\.picture\."):
        fresh("my_world.picture")


@pytest.mark.parametrize(
    ("start", "reached"),
    [
        ("envs.modelnet.sources", "envs.modelnet.sources"),
        ("envs.modelnet.sources", "envs.modelnet.readers"),
        ("envs.modelnet.sources", "scenery.rays"),
        ("envs.modelnet.sources", "scenery.shapes.solids"),
        ("envs.avd.prepare", "envs.crops"),
        ("envs.avd.prepare", "envs.avd.scan"),
        ("envs.avd.writer", "envs.avd.homes"),
        ("envs.avd.writer", "scenery.rooms.textures"),
        ("envs.thor.record", "envs.thor.lattice"),
        ("envs.thor.record", "envs.crops"),
        ("envs.thor.standin", "envs.thor.standin_scenes"),
        ("envs.thor.standin", "scenery.rooms.fittings"),
    ],
)
def test_worlds_depend_on_what_they_import(
    start: str, reached: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, source = fresh(f"activelsd.{start}"), digest._source
    original = source(f"activelsd.{reached}")
    assert original is not None
    changed = tmp_path / original.name
    monkeypatch.setattr(
        digest, "_source", lambda name: changed if name == f"activelsd.{reached}" else source(name)
    )
    changed.write_text(original.read_text() + "\nCONSTANT = 1\n")
    assert fresh(f"activelsd.{start}") != before
    changed.write_text(original.read_text() + "\n# a comment\n")
    assert fresh(f"activelsd.{start}") == before
    code_digest.cache_clear()


@pytest.mark.parametrize("reached", ["envs.modelnet.splits", "envs.episode", "envs.cache", "envs.workers"])
def test_what_makes_no_picture_is_left_out(
    reached: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = [f"activelsd.envs.{name}" for name in ("modelnet.sources", "avd.prepare", "thor.record")]
    before, source = fresh(*starts), digest._source
    changed = tmp_path / "changed.py"
    changed.write_text("CONSTANT = 1\n")
    monkeypatch.setattr(
        digest, "_source", lambda name: changed if name == f"activelsd.{reached}" else source(name)
    )
    assert fresh(*starts) == before


def test_it_is_fast() -> None:
    code_digest.cache_clear()
    began = time.process_time()
    code_digest("activelsd.envs.thor.standin")
    assert time.process_time() - began < 0.3  # twice over what it takes on a slow machine
    began = time.process_time()
    code_digest("activelsd.envs.thor.standin")
    assert time.process_time() - began < 0.01
