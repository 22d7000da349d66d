"""What all tests share: one thread, a cache of their own, and reasons to skip."""

from __future__ import annotations

import importlib.util
import os
import signal
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

# Before anything imports torch: small networks are faster on one thread, and sums come out the same.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
import torch
from hypothesis import settings

# A shell that starts tests in the background has them ignore Ctrl-C, and so what they start to interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("here", deadline=None, derandomize=True)
settings.load_profile("here")


def _let_torchvision_import() -> None:
    """Define two operators that timm's torchvision asks for, and that nothing here uses.

    PyPI's torchvision has them in a library for PyPI's torch; beside a CPU wheel of torch it does not load.
    """
    try:
        torch_build, vision_build = (version(name).partition("+")[2] for name in ("torch", "torchvision"))
    except PackageNotFoundError:
        return
    if torch_build != vision_build:
        operators = torch.library.Library("torchvision", "FRAGMENT")
        for name in ("nms", "qnms"):
            operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        OPERATORS.append(operators)


OPERATORS: list[torch.library.Library] = []  # kept, since they are gone with the library
_let_torchvision_import()

FURNITURE = Path(__file__).parents[2] / "shared" / "data" / "furniture"


@pytest.fixture(autouse=True, scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache folder that is not the user's, shared by all tests."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ACTIVELSD_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session")
def furniture() -> Path:
    """A folder of real meshes, where one lies beside the checkout."""
    if not FURNITURE.is_dir():
        pytest.skip(f"no folder of real meshes at {FURNITURE}")
    return FURNITURE


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what this machine cannot run."""
    if item.get_closest_marker("thor") and importlib.util.find_spec("ai2thor") is None:
        pytest.skip("needs AI2-THOR: pip install -e '.[thor]' && pip install --no-deps ai2thor==5.0.0")
    if item.get_closest_marker("browser") and importlib.util.find_spec("playwright") is None:
        pytest.skip("needs Playwright")
    if item.get_closest_marker("gpu"):
        import torch

        if not torch.cuda.is_available():
            pytest.skip("needs a CUDA device")
