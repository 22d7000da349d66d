"""Parts by name: this package's own, and those that installed packages bring as entry points.

A package brings a part by an entry point of the group `activelsd.<kind>s`, such as `mine =
"my_package:Mine"` in the group `activelsd.trunks`. A part is imported when it is asked for, in the process
that asks; nothing else is ever imported because a config names it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from activelsd.errors import ConfigError, did_you_mean


class UnknownPartError(ConfigError):
    """Raised when no part of a kind has a name; `kind` and `name` say which."""

    def __init__(self, kind: str, name: str, known: list[str]) -> None:
        hint = did_you_mean(name, known)
        super().__init__(f"There is no {kind} '{name}'; {hint}")
        self.kind, self.name = kind, name


@cache
def _installed(group: str) -> dict[str, EntryPoint]:
    return {one.name: one for one in entry_points(group=f"activelsd.{group}")}


class Registry:
    """The parts of one kind by name.

    Attributes:
        kind: what messages call one of them, for example `orbit move`.
        group: the entry points' group after `activelsd.`.
    """

    def __init__(self, kind: str, group: str, own: Mapping[str, str]) -> None:
        """Set it up with this package's own parts, each as `module:attribute`."""
        self.kind, self.group = kind, group
        self._own = {name: EntryPoint(name, value, group) for name, value in own.items()}
        self._added: dict[str, Any] = {}

    def names(self) -> list[str]:
        """The names of all parts, this package's own first."""
        return list({**self._own, **_installed(self.group), **self._added})

    def own(self) -> list[str]:
        """The names of this package's own parts."""
        return list(self._own)

    def get(self, name: str) -> Any:
        """A part by name, imported now if need be.

        Raises:
            UnknownPartError: there is none of that name.
        """
        if name in self._added:
            return self._added[name]
        entry = self._own.get(name) or _installed(self.group).get(name)
        if entry is None:
            raise UnknownPartError(self.kind, name, self.names())
        return entry.load()

    def add(self, name: str, part: Any) -> None:
        """Add a part in this process; other processes find only what is installed."""
        self._added[name] = part

    def package(self, name: str) -> tuple[str, str] | None:
        """Name and version of the package that brings a part; None for parts of this one and added ones."""
        entry = None if name in self._own or name in self._added else _installed(self.group).get(name)
        return None if entry is None or entry.dist is None else (entry.dist.name, entry.dist.version)


_ORBIT_MOVES = (
    *("orbit_cw", "orbit_ccw", "orbit_cw_60", "orbit_ccw_60", "orbit_cw_90", "orbit_ccw_90"),
    *("orbit_opposite", "orbit_up", "orbit_down"),
)

worlds = Registry(
    "world",
    "worlds",
    {
        "modelnet": "activelsd.envs.modelnet.settings:ModelNetSettings",
        "avd": "activelsd.envs.avd.settings:AVDSettings",
        "thor": "activelsd.envs.thor.settings:THORSettings",
    },
)
orbit_moves = Registry(
    "orbit move",
    "orbit_moves",
    {name: f"activelsd.envs.modelnet.orbit:{name.upper()}" for name in _ORBIT_MOVES},
)
players = Registry(
    "player",
    "players",
    {
        "no_move": "activelsd.evaluate.players:NoMove",
        "random_walk": "activelsd.evaluate.players:RandomWalk",
        "random_policy": "activelsd.evaluate.players:RandomPolicy",
        "all_views": "activelsd.evaluate.players:AllViews",
        "forward": "activelsd.evaluate.walkers:Forward",
        "object_search": "activelsd.evaluate.walkers:ObjectSearch",
        "oracle": "activelsd.evaluate.walkers:Oracle",
        "next_best_move": "activelsd.evaluate.nextbest:NextBestMove",
    },
)
trunks = Registry(
    "trunk",
    "trunks",
    {"compact": "activelsd.policy.trunks:Compact", "alexnet": "activelsd.policy.trunks:AlexNet"},
)
memories = Registry(
    "memory",
    "memories",
    {
        "stack": "activelsd.policy.memories:Stack",
        "lstm": "activelsd.policy.memories:LSTM",
        "pool": "activelsd.policy.memories:Pool",
    },
)
terms = Registry(
    "loss term",
    "terms",
    {"supervised": "activelsd.train.terms:Supervised", "guided": "activelsd.train.terms:Guided"},
)
figures = Registry("figure", "figures", {"spl": "activelsd.evaluate.metrics:spl"})
loggers = Registry("logger", "loggers", {"tensorboard": "activelsd.train.logging:TensorBoard"})
