"""The package of `docs/extending.md`: built, installed, and used by the plain command line."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import gymnasium
import numpy as np
import pytest

from activelsd import cli, registry
from activelsd.compose import resolve
from activelsd.envs.world import world_settings
from activelsd.errors import ConfigError
from activelsd.policy.checkpoint import load_network
from activelsd.testing import check_recogniser, check_world
from activelsd.train.run import Run

PAGE = Path(__file__).parent.parent / "docs" / "extending.md"
SMALL = ("env.size=32", "policy.trunk.features=16", "train.envs=8", "threads=1", "train.evaluate_every=400")
SHAPES = ("env.dataset.train_per_class=3", "env.dataset.test_per_class=1", "env.dataset.classes=[cup,vase]")
PARTS = ("policy.trunk=strided", "policy.memory=mean", "train.terms.inverse=0.1")
LIMITS = {
    "Turntable": 40,
    "Strided": 24,
    "Mean": 16,
    "Inverse": 21,
    "LookTwice": 15,
    "MeanPicture": 22,
    "right_at_first": 3,
}


def write_package(folder: Path) -> None:
    """Write the page's blocks to the files that their first lines name."""
    for path, text in re.findall(r"```(?:toml|python)\n# (\S+)\n(.*?)```", PAGE.read_text(), re.DOTALL):
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    (folder / "lsd_turntable/__init__.py").write_text("")
    project = folder / "pyproject.toml"
    trunks = '[project.entry-points."activelsd.trunks"]\n'
    project.write_text(project.read_text().replace(trunks, f'{trunks}deep = "lsd_turntable.deep:Deep"\n'))


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the package is installed, and nothing else."""
    source, site = tmp_path_factory.mktemp("package"), tmp_path_factory.mktemp("site")
    write_package(source)
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*install, "--target", str(site), str(source)], check=True, capture_output=True)
    return site


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("PYTHONPATH", str(site))  # for the workers of a cluster
    registry._installed.cache_clear()
    yield
    registry._installed.cache_clear()


@pytest.fixture(scope="session")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten objects, seen from 8 to 20 sides each."""
    root, rng = tmp_path_factory.mktemp("photographs"), np.random.default_rng(0)
    for kind in ("boot", "hat"):
        for number in range(5):
            folder = root / kind / f"{kind}_{number}"
            folder.mkdir(parents=True)
            for view in range((8, 10, 12, 18, 20)[number]):
                picture = rng.integers(0, 128, (40, 40)).astype(np.uint8) + (kind == "hat") * np.uint8(100)
                cv2.imwrite(str(folder / f"{view:03d}.png"), picture)
    return root


def run_of(capsys: pytest.CaptureFixture[str], *words: str) -> Path:
    assert cli.main(["train", *words]) == 0
    return Path(capsys.readouterr().out.splitlines()[-1])


@pytest.mark.usefixtures("installed")
def test_a_package_brings_every_kind_of_part(
    photographs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["envs"]) == 0
    assert "env=turntable  (lsd-turntable 0.1.0)\n" in capsys.readouterr().out
    cli.main(["doctor"])
    assert "trunk strided            lsd-turntable 0.1.0\n" in capsys.readouterr().out
    world = ("env=turntable", f"env.path={photographs}", *PARTS, *SMALL)
    assert cli.main(["train", *world, "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert f"path: {photographs}  # folder of CLASS/OBJECT/*.png" in said
    assert "gamma: 0.95" in said, "the world's advice"
    run = run_of(capsys, *world, "train.steps=800", "env.rules.max_views=20")
    network = load_network(Run(run).checkpoint)
    assert [type(part).__name__ for part in (network.trunk, network.memory)] == ["Strided", "Mean"]
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert all(0 < row["loss/inverse"] < 2 for row in rows if "reward" in row)
    versions = json.loads((run / "versions.json").read_text())
    assert versions["lsd-turntable"] == "0.1.0"
    assert versions["parts"]["trunk strided"] == "lsd-turntable 0.1.0"

    asked = ["--baselines", "no_move,look_twice,all_views", "--recognisers", "mean_picture,mvcnn"]
    assert cli.main(["compare", *asked, "evaluate.epochs=2"]) == 0
    assert "right_at_first" in capsys.readouterr().out
    rows = json.loads((run / "comparison.json").read_text())["recognisers"]
    assert [(row["name"], row["views"]) for row in rows[:2]] == [("mean_picture", 20), ("mean_picture", 3)]
    players = {one["name"]: one for one in json.loads((run / "comparison.json").read_text())["players"]}
    assert players["look_twice"]["views"] == 2
    assert players["no_move"]["right_at_first"] == players["no_move"]["accuracy"]
    assert players["all_views"]["views"] > 12, "rings have up to twenty views"
    assert cli.main(["evaluate", str(run), "split=val"]) == 0
    run_of(capsys, "--resume", str(run), "train.steps=1600")
    assert (run / "checkpoints" / "000000001600").is_dir()


@pytest.mark.usefixtures("installed")
def test_its_parts_work_beside_this_packages_own(
    photographs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    joint = run_of(
        capsys, "env=modelnet,turntable", f"env.path={photographs}", *SMALL, *SHAPES, "train.steps=800"
    )
    assert joint.name.endswith("modelnet+turntable")
    assert cli.main(["compare", str(joint), "--baselines", "look_twice"]) == 0
    assert (joint / "comparison_turntable.json").exists()
    moves = "env.navigate=[orbit_cw,orbit_150]"
    orbit = run_of(capsys, "env=modelnet", moves, *SHAPES, *SMALL, "train.steps=400")
    assert load_network(Run(orbit).checkpoint).tree.leaves[1] == ("orbit_cw", "orbit_150")
    deep = resolve(["env=modelnet", "policy.trunk=deep", "policy.trunk.layers=2"])
    assert deep.policy.trunk.own() == {"layers": 2}
    with pytest.raises(ConfigError, match=r"policy.trunk.layers=0: must be at least 1"):
        resolve(["env=modelnet", "policy.trunk=deep", "policy.trunk.layers=0"])
    with pytest.raises(ConfigError, match=r"env\.path must be given: folder of"):
        resolve(["env=turntable"])


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("actors", ["ga3c", "ray"])
def test_other_processes_find_the_parts(
    actors: str, photographs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    many = {
        "ga3c": ["train.ga3c.agents=2", "train.ga3c.envs_per_agent=2"],
        "ray": ["train.ray.workers=1", "train.ray.envs_per_worker=4"],
    }
    world = ("env=turntable", f"env.path={photographs}", f"runs={tmp_path}", *PARTS, *SMALL)
    run = run_of(capsys, *world, f"train.actors={actors}", *many[actors], "train.steps=200")
    assert Run(run).checkpoint.is_dir()


@pytest.mark.usefixtures("installed")
def test_gymnasium_makes_the_world_and_it_is_sound(photographs: Path, tmp_path: Path) -> None:
    env = gymnasium.make("activelsd/World-v0", world="turntable", path=photographs, size=32)
    assert env.reset(seed=0)[1]["backend"] == "turntable"
    world = world_settings("turntable", {"path": photographs, "size": 32})
    check_world(world, train_steps=400)
    check_recogniser("mean_picture", world)


def test_a_run_says_which_package_it_misses(
    site: Path,
    photographs: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(site))
        registry._installed.cache_clear()
        words = ("env=turntable", f"env.path={photographs}", f"runs={tmp_path}", *PARTS, *SMALL)
        run = run_of(capsys, *words, "train.steps=200")
        shapes = ("env=modelnet", *SHAPES, *SMALL, f"runs={tmp_path}", "train.steps=200")
        term = run_of(capsys, *shapes, "train.terms.inverse=0.1", "name=term")
        move = run_of(capsys, *shapes, "env.navigate=[orbit_cw,orbit_150]", "name=move")
    registry._installed.cache_clear()
    for verb, of, part in (
        (["compare"], run, "world 'turntable'"),
        (["train", "--resume"], term, "loss term 'inverse'"),
        (["compare"], move, "orbit move 'orbit_150'"),
    ):
        assert cli.main([*verb, str(of)]) == 2
        assert capsys.readouterr().err.splitlines()[-1] == (
            f"activelsd: {of} was made with the {part} of the package lsd-turntable 0.1.0, which is not"
            " installed here; install it with: pip install lsd-turntable"
        )
    assert cli.main(["compare", str(term)]) == 0, "a loss term is of no use to a finished run"
    capsys.readouterr()
    assert cli.main(["train", "env=turntabel"]) == 2
    assert "There is no world 'turntabel'" in capsys.readouterr().err


def test_parts_are_as_short_as_promised(tmp_path: Path) -> None:
    """The lines of each part, without blank ones and docstrings."""
    write_package(tmp_path)
    text = "\n".join(file.read_text() for file in sorted(tmp_path.glob("lsd_turntable/*.py")))
    for name, limit in LIMITS.items():
        match = re.search(rf"^(?:class|def) {name}\b.*?(?=^\S|\Z)", text, re.DOTALL | re.MULTILINE)
        assert match is not None
        lines = [line for line in match[0].splitlines() if line.strip() and '"""' not in line]
        assert len(lines) <= limit, f"{name} has {len(lines)} lines"


def test_every_python_block_of_the_pages_runs(tmp_path: Path) -> None:
    shutil.copytree(PAGE.parent, tmp_path / "docs")
    blocks = [
        (page.name, text)
        for page in sorted(PAGE.parent.glob("*.md"))
        if page != PAGE  # its blocks are the package above
        for text in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    ]
    assert len(blocks) >= 2
    program = "\n".join(f"exec({text!r}, {{}})\nprint({name!r})" for name, text in blocks)
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("code", "word", "said"),
    [
        (
            "raise RuntimeError('no licence')",
            "env=mine",
            "world 'mine' of the package lost 1.0 cannot be imported (RuntimeError: no licence)",
        ),
        (
            "import sys\nsys.exit(3)",
            "env=mine",
            "world 'mine' of the package lost 1.0 cannot be imported (SystemExit: 3)",
        ),
        (
            "part = 5",
            "env=mine",
            "world 'mine' of the package lost 1.0 is no subclass of activelsd.envs.settings.WorldSettings",
        ),
        (
            "def part(network): return network",
            "train.terms.mine=1",
            "loss term 'mine' of the package lost 1.0 is no subclass of activelsd.train.terms.Term",
        ),
    ],
)
def test_a_broken_part_is_named_with_its_package(
    code: str,
    word: str,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "lost_part.py").write_text(code)
    about = tmp_path / "lost-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lost\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[activelsd.worlds]\nmine = lost_part:part\n[activelsd.terms]\nmine = lost_part:part\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "lost_part", raising=False)
    registry._installed.cache_clear()
    try:
        words = ["train", "env=modelnet", word, *SHAPES, *SMALL, f"runs={tmp_path / 'runs'}"]
        assert cli.main(words) == 2
        sentence = capsys.readouterr().err.splitlines()[-1]
        assert sentence == f"activelsd: The {said}; mend or uninstall that package."
        assert not list(tmp_path.glob("runs/*"))
        assert cli.main(["envs"]) == 0
        assert "env=mine  (lost 1.0)\n" in capsys.readouterr().out
    finally:
        registry._installed.cache_clear()
