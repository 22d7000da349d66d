"""The worlds, behind one Gymnasium interface; importing `gymnasium` registers them by its plug-in entry point."""

from __future__ import annotations


def register() -> None:
    """Register every world with Gymnasium, single and vectorised."""
    import gymnasium  # noqa: PLC0415  the command line reads this package without it

    if "activelsd/ModelNet-v0" not in gymnasium.registry:
        gymnasium.register(
            "activelsd/ModelNet-v0",
            entry_point="activelsd.envs.modelnet.env:ModelNetEnv",
            vector_entry_point="activelsd.envs.modelnet.env:make_vector",
        )
