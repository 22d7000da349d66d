"""The worlds, behind one Gymnasium interface; importing this package registers them with Gymnasium.

`activelsd/World-v0` is any of them, by `world=NAME` and the settings of that world as keywords. Gymnasium
takes as long to import as a mistyped setting may take to be answered, so it is not imported here: the
worlds are registered now if it has been imported, else as soon as it is.
"""

import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType


def register() -> None:
    """Register the worlds with Gymnasium."""
    import gymnasium

    ids = {"World-v0": {}, "ModelNet-v0": "modelnet", "AVD-v0": "avd", "THOR-v0": "thor"}
    for name, world in ids.items():
        gymnasium.register(
            f"activelsd/{name}",
            entry_point="activelsd.envs.world:make",
            vector_entry_point="activelsd.envs.world:make_vector",
            kwargs={"world": world} if world else {},
        )


class _WhenImported(MetaPathFinder):
    """Registers the worlds right after Gymnasium's own import."""

    _finding = False

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != "gymnasium" or self._finding:
            return None
        self._finding = True  # the other finders look for it now
        spec = find_spec(name)
        self._finding = False
        if spec is not None and isinstance(spec.loader, Loader):
            run = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                run(module)
                sys.meta_path.remove(self)  # only now: a spec may be asked for without an import
                register()

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


if "gymnasium" in sys.modules:
    register()
else:
    sys.meta_path.insert(0, _WhenImported())
