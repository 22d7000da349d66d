"""Groups of settings: what they are written as, their dotted keys, and how text becomes their values.

Everything here holds for any pydantic model; which groups a run has is `activelsd.config`'s to say. Wrong
keys and values get one sentence that names the setting, what is wrong, and the nearest right one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, get_args, get_origin

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetCoreSchemaHandler, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, ErrorDetails, PydanticUndefined
from pydantic_core.core_schema import no_info_before_validator_function

from activelsd.errors import ConfigError, did_you_mean

AbsolutePath = Annotated[Path, AfterValidator(lambda path: path.expanduser().absolute())]
"""A path kept absolute, so that a run's config means the same from every folder."""

Colour = Literal["gray", "rgb"]
"""What a picture has: one channel, or red, green and blue."""


class Section(BaseModel):
    """A group of settings: frozen, without room for a key it does not know.

    Attributes:
        shorthand: the setting that is meant if the group itself is given a value, as in `env.dataset=sample`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)
    shorthand: ClassVar[str | None] = None


class Part(Section):
    """Settings of a part that is found by name, such as a trunk; a part with others has a subclass."""

    shorthand: ClassVar[str | None] = "kind"
    advice: ClassVar[Mapping[str, Any]] = {}
    """What learns best with this trunk, as settings of the run by dotted key; a world's advice wins."""

    kind: str = Field(description="the part's name")

    def check(self) -> None:
        """Raise ConfigError if something that the settings name is not there; called before work begins."""

    def own(self) -> dict[str, Any]:
        """The settings by name, without the part's own name."""
        return self.model_dump(mode="json", exclude={"kind"})


class ByName:
    """Annotates a field whose class of settings follows from a name.

    Attributes:
        find: the class for a name; raises ConfigError for an unknown one.
        key: the setting that holds the name.
        base: the class that all of them derive from.
    """

    def __init__(self, find: Callable[[str], type[Section]], key: str, base: type[Section]) -> None:
        self.find, self.key, self.base = find, key, base

    def make(self, value: object) -> object:
        """Settings from a name, or from a dict that holds it; anything else is returned as it is."""
        value = {self.key: value} if isinstance(value, str) else value
        if isinstance(value, Mapping) and self.key in value:
            return self.find(str(value[self.key])).model_validate(value)
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """What pydantic does first with a value of the field."""
        return no_info_before_validator_function(self.make, handler(source))


class Setting(NamedTuple):
    """A value as it was written, and where: a file, a world's advice; None for the command line."""

    value: Any
    file: Path | str | None = None

    @property
    def place(self) -> str:
        """Where it was written, as ` (in FILE)`, for a sentence."""
        return f" (in {self.file})" if self.file else ""


class TextLoader(yaml.SafeLoader):
    """YAML whose scalars stay text, null aside: the schema decides, since YAML takes `3e-4` for text."""

    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, pattern) for tag, pattern in pairs if tag.endswith(":null")]
        for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


def flatten(content: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Nested values as pairs of dotted key and value; an empty dict is a value."""
    for key, value in content.items():
        if isinstance(value, Mapping) and value:
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


class Schema:
    """The settings of a model, with the classes that the names among some layers choose.

    Attributes:
        fields: every setting by its dotted key, the defaults' entries of a dict among them.
        groups: the class of every group of settings by its dotted key.
        defaults: the models' defaults as nested values.
    """

    def __init__(self, model: type[BaseModel], layers: Mapping[str, Setting]) -> None:
        self._model, self._layers = model, layers
        self.fields: dict[str, FieldInfo] = {}
        self.groups: dict[str, type[BaseModel]] = {}
        self._marks: dict[str, ByName] = {}
        self._written: dict[str, Setting] = {}  # by the key that is meant
        self.defaults = self._walk(model, "")

    def _walk(self, model: type[BaseModel], prefix: str) -> dict[str, Any]:
        tree: dict[str, Any] = {}
        for name, field in model.model_fields.items():
            key, default = f"{prefix}{name}", field.default
            section = self._section(key, field)
            if section is not None:
                self.groups[key] = section
                tree[name] = self._walk(section, f"{key}.")
                if isinstance(default, section):
                    tree[name] |= default.model_dump(exclude_unset=True)
                continue
            self.fields[key] = field
            if default is not PydanticUndefined:
                tree[name] = default
            for entry in default if isinstance(default, dict) else ():
                self.fields[f"{key}.{entry}"] = self._entry(field)
        for name, mark in members(model, prefix, self._layers).items():
            self._marks[prefix + name] = mark
            self.groups[prefix + name] = mark.find(str(self._layers[f"{prefix}{name}.{mark.key}"].value))
            tree[name] = self._walk(self.groups[prefix + name], f"{prefix}{name}.")
        return tree

    def _section(self, key: str, field: FieldInfo) -> type[BaseModel] | None:
        """The class of a group of settings; None for a single setting."""
        mark = next((one for one in field.metadata if isinstance(one, ByName)), None)
        if mark is None:
            return next(_models(field.annotation), None)
        self._marks[key] = mark
        named = self._layers.get(f"{key}.{mark.key}") or self._layers.get(key)
        name = getattr(field.default, mark.key, None) if named is None else str(named.value)
        return mark.base if name is None else mark.find(name)

    def _entry(self, field: FieldInfo) -> FieldInfo:
        """An entry of a dict, as a setting of its own."""
        return FieldInfo(annotation=get_args(field.annotation)[1], description=field.description)

    def find(self, key: str) -> tuple[str, FieldInfo] | None:
        """The setting that a key means, and its field; None if there is no such setting.

        A group means its shorthand, and a dict takes any key below its own.
        """
        short = getattr(self.groups.get(key), "shorthand", None)
        key = key if short is None else f"{key}.{short}"
        if key in self.fields:
            return key, self.fields[key]
        above = self.fields.get(key.rpartition(".")[0])
        return (key, self._entry(above)) if above is not None and isinstance(above.default, dict) else None

    def names(self) -> list[str]:
        """Every setting by the key that one would write: a group in place of its shorthand."""
        short = {f"{key}.{getattr(group, 'shorthand', None)}": key for key, group in self.groups.items()}
        return [short.get(key, key) for key in self.fields]

    def build(self) -> Any:
        """The model of the layers upon the defaults.

        Raises:
            KeyError: with a key that is no setting.
            ConfigError: a value is not one that its setting takes.
        """
        tree = self.defaults
        for written, setting in self._layers.items():
            found = self.find(written)
            if found is None:
                raise KeyError(written)
            node, leaf = _inside(tree, found[0])
            node[leaf] = typed(setting, found[1])
            self._written[found[0]] = setting
        # The innermost first, so that what is refused is known by its whole key.
        for key, mark in sorted(self._marks.items(), key=lambda one: -one[0].count(".")):
            node, leaf = _inside(tree, key)
            node[leaf] = self._validated(f"{key}.", mark.make, node[leaf])
        return self._validated("", self._model.model_validate, tree)

    def _validated(self, prefix: str, make: Callable[[Any], Any], value: Any) -> Any:
        try:
            return make(value)
        except ValidationError as refused:
            error = refused.errors()[0]
        key = prefix + ".".join(part for part in error["loc"] if isinstance(part, str))
        found = self.find(key) or self.find(key.rpartition(".")[0])
        if found is None:
            raise ConfigError(f"{key}: {error['msg']}.")
        key, field = found
        setting = self._written.get(key, Setting(error["input"], "its default"))
        raise ConfigError(refused_value(key, setting, field, error))


def members(model: type[BaseModel], prefix: str, layers: Mapping[str, Setting]) -> dict[str, ByName]:
    """The sections of a model that takes any number of them by name, among the keys of some layers."""
    mark = getattr(model, "member", None)
    if not isinstance(mark, ByName):
        return {}
    found = (re.fullmatch(rf"{re.escape(prefix)}(\w+)\.{mark.key}", key) for key in layers)
    return {match[1]: mark for match in found if match}


def _inside(tree: dict[str, Any], key: str) -> tuple[dict[str, Any], str]:
    """The dict that holds a dotted key's value, and the last part of the key."""
    *parents, leaf = key.split(".")
    for name in parents:
        tree[name] = tree = dict(tree[name])  # defaults are shared
    return tree, leaf


def _models(kind: object) -> Iterator[type[BaseModel]]:
    """The models in an annotation, however deep a union or an optional stands around them."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
    elif get_origin(kind) not in (list, tuple, dict):
        for inner in get_args(kind):
            yield from _models(inner)


def is_path(field: FieldInfo) -> bool:
    """Whether a setting is the path of a file or folder."""
    return any(kind is Path for kind in _kinds(field.annotation))


def _kinds(kind: object) -> Iterator[object]:
    """The types in an annotation, however deep."""
    yield kind
    for inner in get_args(kind):
        yield from _kinds(inner)


def typed(setting: Setting, field: FieldInfo) -> Any:
    """What a text means to a field, beyond what the schema converts by itself."""
    text, kinds = setting.value, get_args(field.annotation) or (field.annotation,)
    if not isinstance(text, str):
        return text
    if setting.file is None and text in ("null", "~"):
        return None
    if setting.file is None and any(
        (get_origin(kind) or kind) in (list, tuple) for kind in (field.annotation, *kinds)
    ):
        # On the command line a list may leave out its brackets: env.navigate=orbit_cw,orbit_ccw.
        try:
            return yaml.load(text if text.startswith("[") else f"[{text}]", TextLoader)
        except yaml.YAMLError:
            return text
    if int in kinds and re.fullmatch(r"\d+(\.\d+)?[eE]\+?\d+", text) and float(text).is_integer():
        return int(float(text))  # 2e6 is a whole number to everyone but int()
    return text


def dump(section: BaseModel) -> str:
    """Settings as YAML, each with what it means."""
    return "\n".join(_lines(section, "")) + "\n"


def _lines(section: BaseModel, indent: str) -> Iterator[str]:
    fields = type(section).model_fields
    plain = section.model_dump(mode="json")
    for name, value in section:
        about = fields[name].description if name in fields else "a world"
        if isinstance(value, BaseModel):
            yield f"{indent}{name}:  # {about}"
            yield from _lines(value, indent + "  ")
        else:
            text = yaml.safe_dump(plain[name], default_flow_style=True, width=10**6, allow_unicode=True)
            yield f"{indent}{name}: {text.removesuffix('...' + chr(10)).strip()}  # {about}"


_WANTED = {
    "bool_parsing": "true or false",
    "finite_number": "a finite number",
    "float_parsing": "a number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "list_type": "a list, as in [a,b]",
    "missing": "given",
    "string_pattern_mismatch": "letters, digits and . _ + - only",
    "string_type": "text",
    "tuple_type": "a list, as in [a,b]",
}
"""What each of pydantic's complaints asks for; its own words stand for the others."""


def refused_value(key: str, setting: Setting, field: FieldInfo, error: ErrorDetails) -> str:
    """The sentence about a value that a setting does not take."""
    if error["type"] == "dict_type":
        return f"{key}={setting.value}{setting.place}: must be set by its entries, as in {key}.NAME=…"
    if error["type"] == "missing":
        return f"{key} must be given: {field.description}."
    value = setting.value
    if isinstance(value, (list, tuple)):
        value = f"[{','.join(map(str, value))}]"
    start = f"{key}={value}{setting.place}: must be"
    if error["type"] == "literal_error":
        expected = error["ctx"]["expected"]
        hint = did_you_mean(str(error["input"]), re.findall(r"'([^']+)'", expected), "")
        return f"{start} {expected}" + (f"; {hint}" if hint else ".")
    wanted = _WANTED.get(error["type"]) or re.sub(r"^\w+ should (be|have) ", "", error["msg"])
    if error["type"] == "too_short":
        wanted = f"a list of at least {error['ctx']['min_length']}"
    wanted = wanted.replace("greater than or equal to", "at least").replace(
        "less than or equal to", "at most"
    )
    return f"{start} {wanted}{', or null' if type(None) in get_args(field.annotation) else ''}."
