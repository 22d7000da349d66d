"""Parts by name: this package's own, and those that installed packages bring as entry points.

A package brings a part by an entry point of the group `activelsd.<kind>s`, such as `mine =
"my_package:Mine"` in the group `activelsd.trunks`. A part is imported when it is asked for, in the process
that asks; nothing else is ever imported because a config names it.

An own name that ends in `:NAME` is a family: `timm:NAME` stands for `timm:resnet18` and all others, and its
class has a class method `named` that makes the class of one of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from activelsd.errors import ActiveLSDError, ConfigError, did_you_mean

_FAMILY = ":NAME"


class UnknownPartError(ConfigError):
    """Raised when no part of a kind has a name; `kind` and `name` say which."""

    def __init__(self, kind: str, name: str, known: list[str], place: str = "") -> None:
        """Word it; `place` says where the name was written, as ` (in FILE)`."""
        super().__init__(f"There is no {kind} '{name}'{place}; {did_you_mean(name, known)}")
        self.kind, self.name, self._words = kind, name, (kind, name, known, place)

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        """How Ray sends it to the learner."""
        return type(self), self._words


class BrokenPartError(ConfigError):
    """Raised when a part of an installed package cannot be imported, or is not a part of its kind."""


@cache
def _installed(group: str) -> dict[str, EntryPoint]:
    return {one.name: one for one in entry_points(group=f"activelsd.{group}")}


class Registry:
    """The parts of one kind by name.

    Attributes:
        kind: what messages call one of them, for example `orbit move`.
        group: the entry points' group after `activelsd.`.
    """

    def __init__(
        self,
        kind: str,
        group: str,
        own: Mapping[str, str],
        settings: Mapping[str, str] | None = None,
        base: str | None = None,
    ) -> None:
        """Set it up with this package's own parts, and the settings of some, each as `module:attribute`.

        `base` is the class, written so too, that parts derive from; None if they need not.
        """
        self.kind, self.group = kind, group
        self._own = {name: EntryPoint(name, value, group) for name, value in own.items()}
        self._settings = {name: EntryPoint(name, value, group) for name, value in (settings or {}).items()}
        self._base = None if base is None else EntryPoint("base", base, group)
        self._added: dict[str, Any] = {}

    def names(self) -> list[str]:
        """The names of all parts, this package's own first."""
        return list({**self._own, **_installed(self.group), **self._added})

    def own(self) -> list[str]:
        """The names of this package's own parts."""
        return list(self._own)

    def installed(self) -> list[str]:
        """The names that other packages give to their parts; those of own parts are without effect."""
        return list(_installed(self.group))

    def _own_name(self, name: str) -> str | None:
        """The name of the own part, or of the family, that a name stands for; None if there is none."""
        family, _, member = name.partition(":")
        if member and f"{family}{_FAMILY}" in self._own:
            return f"{family}{_FAMILY}"
        return name if name in self._own else None

    def family(self, name: str) -> str:
        """The name under which a part is listed: that of its family if it has one, else its own."""
        return self._own_name(name) or name

    def knows(self, name: str) -> bool:
        """Whether a part has a name; nothing is imported."""
        return name in self.names() or self._own_name(name) is not None

    def check(self, name: str, place: str = "") -> None:
        """Raise UnknownPartError if no part has a name, written at a place; nothing is imported."""
        if not self.knows(name):
            raise UnknownPartError(self.kind, name, self.names(), place)

    def get(self, name: str) -> Any:
        """A part by name, imported now if need be.

        Raises:
            UnknownPartError: there is none of that name.
            BrokenPartError: the package that brings it fails to import, or it is not of this kind.
        """
        self.check(name)
        if name in self._added:
            return self._added[name]
        own = self._own_name(name)
        if own is not None:
            part = self._own[own].load()
            return part.named(name.partition(":")[2]) if own.endswith(_FAMILY) else part
        with self.blaming(name, "cannot be imported"):
            part = _installed(self.group)[name].load()
        base = None if self._base is None else self._base.load()
        if base is not None and not (isinstance(part, type) and issubclass(part, base)):
            raise self.broken(name, f"is no subclass of {base.__module__}.{base.__name__}")
        return part

    def broken(self, name: str, what: str) -> BrokenPartError:
        """An error that says what is wrong with a part, and which package brings it."""
        package = self.package(name)
        whose = f" of the package {' '.join(package)}" if package else ""
        way_out = "mend or uninstall that package" if package else "mend it"
        return BrokenPartError(f"The {self.kind} '{name}'{whose} {what}; {way_out}.")

    @contextmanager
    def blaming(self, name: str, what: str) -> Iterator[None]:
        """Turn whatever a part of another package raises inside into a `BrokenPartError`."""
        try:
            yield
        except (Exception, SystemExit) as error:
            if isinstance(error, ActiveLSDError) or self._own_name(name) is not None:
                raise
            raise self.broken(name, f"{what} ({type(error).__name__}: {error})") from error

    def settings(self, name: str) -> Any:
        """The model of a part's own settings; None if it has none.

        A part of another package names it as its attribute `Settings`. Models of this package's parts stand
        apart from them, so that settings are read before PyTorch is imported.

        Raises:
            UnknownPartError: there is no part of that name.
        """
        own = self._own_name(name)
        if own is not None:
            return self._settings[own].load() if own in self._settings else None
        return getattr(self.get(name), "Settings", None)

    def name_of(self, part: Any) -> str | None:
        """The name that a class is registered by; None if it is not. Nothing is imported to find out."""
        value = f"{part.__module__}:{part.__qualname__}"
        for name, one in {**_installed(self.group), **self._own, **self._added}.items():
            if one is part or (isinstance(one, EntryPoint) and one.value == value):
                return name
        return None

    def add(self, name: str, part: Any) -> None:
        """Add a part in this process; other processes find only what is installed."""
        self._added[name] = part

    def package(self, name: str) -> tuple[str, str] | None:
        """Name and version of the package that brings a part; None for parts of this one and added ones."""
        entry = None if self._own_name(name) or name in self._added else _installed(self.group).get(name)
        return None if entry is None or entry.dist is None else (entry.dist.name, entry.dist.version)


def _in(module: str, **attributes: str) -> dict[str, str]:
    """Parts of one module by name."""
    return {name: f"activelsd.{module}:{attribute}" for name, attribute in attributes.items()}


_ORBIT_MOVES = (
    *("orbit_cw", "orbit_ccw", "orbit_cw_60", "orbit_ccw_60", "orbit_cw_90", "orbit_ccw_90"),
    *("orbit_opposite", "orbit_up", "orbit_down"),
)

worlds = Registry(
    "world",
    "worlds",
    _in("envs.modelnet.settings", modelnet="ModelNetSettings")
    | _in("envs.avd.settings", avd="AVDSettings")
    | _in("envs.thor.settings", thor="THORSettings"),
    base="activelsd.envs.settings:WorldSettings",
)
orbit_moves = Registry(
    "orbit move", "orbit_moves", _in("envs.modelnet.orbit", **{name: name.upper() for name in _ORBIT_MOVES})
)
players = Registry(
    "player",
    "players",
    _in("evaluate.players", no_move="NoMove", random_walk="RandomWalk", random_policy="RandomPolicy")
    | _in("evaluate.players", all_views="AllViews")
    | _in("evaluate.walkers", forward="Forward", object_search="ObjectSearch", oracle="Oracle")
    | _in("evaluate.players", sweep="Sweep")
    | _in("evaluate.schedules", quarter="Quarter", spread="Spread")
    | _in("evaluate.nextbest", next_best_move="NextBestMove")
    | _in("evaluate.nextview", expected_entropy="ExpectedEntropy", most_unseen="MostUnseen"),
)
stops = Registry(
    "stop",
    "stops",
    _in("evaluate.stops", learned="Learned", confidence="Confidence"),
    base="activelsd.evaluate.stops:Stop",
)
recognisers = Registry(
    "recogniser",
    "recognisers",
    _in("evaluate.recognisers.mvcnn", mvcnn="MVCNN")
    | _in("evaluate.recognisers.deeppano", deeppano="DeepPano")
    | _in("evaluate.recognisers.shapenets", shapenets="ShapeNets"),
    base="activelsd.evaluate.recognisers.interface:Recogniser",
)
trunks = Registry(
    "trunk",
    "trunks",
    _in("policy.trunks", compact="Compact", alexnet="AlexNet")
    | _in("policy.pretrained", **{"timm:NAME": "TimmTrunk"}),
    settings=_in("policy.settings", alexnet="AlexNetSettings", **{"timm:NAME": "TimmSettings"}),
)
memories = Registry(
    "memory",
    "memories",
    _in("policy.memories", stack="Stack", lstm="LSTM", pool="Pool"),
    base="activelsd.policy.memories:Memory",
)
terms = Registry(
    "loss term",
    "terms",
    _in("train.terms", supervised="Supervised", smoothing="Smoothing", guided="Guided"),
    base="activelsd.train.terms:Term",
)
figures = Registry("figure", "figures", _in("evaluate.metrics", spl="spl"))
loggers = Registry("logger", "loggers", _in("train.logging", tensorboard="TensorBoard"))

ALL = (worlds, orbit_moves, players, stops, recognisers, trunks, memories, terms, figures, loggers)

LEARNED = "learned"
"""In place of a player's name in MOVES+STOP: the moves that the run has learned."""


def moves_and_stop(player: str) -> tuple[str, str]:
    """Who moves and who decides when to answer in a player's name, as in `spread+confidence`.

    A stop alone goes with the learned moves, and `random` moves are those of `random_walk`. A player alone
    has the stop "", its own.

    Raises:
        UnknownPartError: there is no player or no stop of that name.
    """
    if players.knows(player):
        return player, ""
    moves, plus, stop = player.partition("+")
    if not plus:
        if not stops.knows(player):
            raise UnknownPartError("player", player, [*players.names(), *stops.names()], "")
        return LEARNED, player
    stops.check(stop)
    if moves == LEARNED or players.knows(moves):
        return moves, stop
    if moves == "random":
        return "random_walk", stop
    raise UnknownPartError("player", moves, [*players.names(), LEARNED, "random"], "")
