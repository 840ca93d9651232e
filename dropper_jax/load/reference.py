"""Every key of a scene, generated from its declaration: meaning, unit, range, default, source.

The scene reader checks against the same declarations (`base.fields.parameter`, `option`, `base.read.count`), so each
key is described once. Keys that are read by hand have their rows in `data/keys_by_hand.toml`.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib import resources
from itertools import pairwise

import numpy as np

from dropper_jax.axial import LAWS
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath, Table, Values, declared_fields, join, limits
from dropper_jax.base.records import names_of
from dropper_jax.integrators import INTEGRATORS, OPTIONS
from dropper_jax.load.scene_sections import declared_sections

#: Shapes of values in words.
SHAPES = {
    "number": "number",
    "node": "number, or one per node",
    "link": "number, or one per link",
    "joint": "number, or one per joint",
    "vector": "3 numbers",
    "table": "list of numbers",
    "vectors": "list of 3-vectors",
    "numbers": "number, or a list",
}
TYPES = {int: "whole number", bool: "truth value", tuple: "list of whole numbers", list: "list of texts"}
#: A sentence of a docstring that gives a source.
SOURCE = re.compile(
    r"[^.;]*\b(?:[Tt]hesis|[Pp]aper|MoorDyn|[Ee]quation|Table|DNV|1[89]\d\d|20[012]\d)\b[^;]*?(?:\.(?=\s|$)|;|$)"
)


@dataclasses.dataclass(frozen=True)
class Key:
    """A key of a scene.

    Attributes:
        path: in the syntax of `--set`, `*` for the number or name of an entry.
        kind: type of its value, in words.
        allowed: range or choices, in words.
        default: in words; `needed` if it is required, `none` if it is optional.
        schema: its JSON Schema.
    """

    path: str
    meaning: str
    kind: str
    unit: str = "-"
    allowed: str = ""
    default: str = "none"
    schema: Values = dataclasses.field(default_factory=dict)

    @property
    def name(self) -> str:
        return ScenePath(self.path).key


@dataclasses.dataclass(frozen=True)
class Section:
    """A table of a scene: its head in TOML, its meaning, its source, its keys."""

    path: str
    head: str
    about: str
    source: str
    keys: tuple[Key, ...]


TEXT = {"type": "string"}
NUMBER = {"type": ["number", "string"]}
LIST = {"type": "array"}
AXIAL_LAW = Key("line.*.axial.law", f"axial law: {', '.join(LAWS)}; default: rope", "text", schema={"enum": list(LAWS)})


@cache
def _by_hand() -> Table:
    """What `data/keys_by_hand.toml` says of each section."""
    return tomllib.loads((resources.files("dropper_jax") / "data" / "keys_by_hand.toml").read_text(encoding="utf-8"))


def _keys_by_hand(path: str) -> list[Key]:
    """Keys of a section that are read by hand."""
    found = []
    if path == "line.*.axial":
        found.append(AXIAL_LAW)
    for row in _by_hand().get(path, {}).get("keys", ()):
        about = dict(row)
        found.append(Key(join(path, about.pop("name")), **about))
    return found


def sections() -> list[Section]:
    """All sections of a scene, with effects registered from outside."""
    return [_section(*row) for row in declared_sections()]


def _section(path: str, head: str, cls: type | None) -> Section:
    keys: list[Key] = []
    source = ""
    if cls is not None:
        keys += _declared_keys(path, cls)
        source = source_of(cls)
    by_hand = _keys_by_hand(path)
    if path == "run":
        keys += [_option(name, about) for name, about in OPTIONS.items()]
    if path in ("line.*.axial", "line_type.*"):
        keys += _law_keys(path, set(names_of((*keys, *by_hand))))
    if path == "point_type.*":
        keys = [key for key in keys if key.name != "position"]
    about = _by_hand().get(path, {}).get("about") or inspect.getdoc(cls) or ""
    return Section(path, head, _first(about), source, (*keys, *by_hand))


def _law_keys(path: str, listed: set[str]) -> Iterable[Key]:
    """Keys of axial laws in addition to those already listed."""
    found: dict[str, Key] = {}
    for law in LAWS.values():
        for key in _declared_keys(path, law):
            if key.name not in listed:
                found[key.name] = key
    return found.values()


def _declared_keys(path: str, cls: type) -> Iterable[Key]:
    """Keys declared by a class."""
    for key, field in declared_fields(cls).items():
        about = field.metadata
        number = about["kind"] == "parameter"
        allowed = ""
        if number or about.get("type") is int:
            allowed = limits({**about, "unit": "-"})
        elif about.get("choices"):
            allowed = ", ".join(map(str, about["choices"]))
        kind = TYPES.get(about.get("type"), "text")
        if number:
            kind = SHAPES[about["shape"]]
        unit = about.get("unit", "-")
        yield Key(f"{path}.{key}", about["meaning"], kind, unit, allowed, _default(field), _schema(about))


def _option(name: str, about: Values) -> Key:
    takers = ", ".join(scheme for scheme, one in INTEGRATORS.items() if name in one.options())
    meaning = f"{about.get('meaning', name)} ({takers})"
    return Key(f"run.{name}", meaning, "number", "-", limits({**about, "unit": "-"}), "that of the scheme", NUMBER)


def _default(field: dataclasses.Field) -> str:
    match value := field.default:
        case dataclasses.MISSING:
            return "needed"
        case None | bool():
            return {None: "none", True: "true", False: "false"}[value]
        case (str(), *_):
            return str(list(value))
        case tuple() | list() | np.ndarray():
            return str(list(map(float, value)))
        case float():
            return f"{value:g}"
    return str(value)


def _schema(about: Values) -> Table:
    """JSON Schema of a declared value; a text may be an expression of the scene's parameters."""
    if about["kind"] != "parameter":
        if about.get("choices"):
            return {"enum": list(about["choices"])}
        kinds = {int: {"type": ["integer", "string"]}, bool: {"type": "boolean"}, tuple: LIST, list: LIST}
        return kinds.get(about.get("type"), TEXT)
    number: Table = {"type": ["number", "string"]}
    for key, word in (("low", "minimum"), ("above", "exclusiveMinimum"), ("high", "maximum")):
        if about.get(key) is not None:
            number[word] = about[key]
    several = {"type": "array", "items": number}
    shapes = {
        "number": number,
        "vector": {**several, "minItems": 3, "maxItems": 3},
        "vectors": {"type": "array", "items": several},
        "table": several,
    }
    return shapes.get(about["shape"], {"anyOf": [number, several]})


def source_of(cls: type) -> str:
    """Sentences of a class's and its module's documentation that give its source."""
    found: dict[str, None] = {}  # each once, in order
    for text in (inspect.getdoc(cls) or "", sys.modules[cls.__module__].__doc__ or ""):
        for match in SOURCE.finditer(" ".join(text.split())):
            found[match[0].strip()] = None
    return " ".join(filter(None, found))


def _first(text: str) -> str:
    """The first paragraph."""
    return " ".join(text.split("\n\n")[0].split())


def find(word: str) -> list[Section]:
    """Sections whose path, or whose keys' paths, are or end in a word; numbers and names of entries may replace `*`.

    Raises:
        SceneError: no section matches; the message suggests the nearest.
    """
    every = sections()
    wanted = word.strip(".[]")
    found = []
    for section in every:
        if _matches(section.path, wanted) or section.head.strip("[]") == wanted:
            found.append(section)
        elif keys := tuple(key for key in section.keys if _matches(key.path, wanted) or key.name == wanted):
            found.append(dataclasses.replace(section, keys=keys))
    if not found:
        known = set()
        for section in every:
            known.add(section.path)
            for key in section.keys:
                known |= {key.path, key.name}
        hint = nearest(word, known - {""})
        if hint.startswith("known"):
            hint = "all: --reference"
        raise SceneError(f"--reference: {word!r} is not a key; {hint}")
    return found


def _matches(path: str, word: str) -> bool:
    """Whether a path with `*` matches the word; list entries may be given by number, name or omitted."""
    plain = path.replace(".*", "")
    pattern = re.escape(path).replace(r"\*", r"[^.]+")
    return bool(path) and (word == plain or re.fullmatch(pattern, word) is not None)


def schema() -> Table:
    """JSON Schema (2020-12) of a scene."""
    root: Table = {"type": "object", "properties": {}, "additionalProperties": False}
    for section in sections():
        target = _section_object(root, section.path)
        for key in section.keys:
            if key.name == "*":
                target["additionalProperties"] = dict(key.schema)
            else:
                target["properties"][key.name] = {"description": _description(key), **key.schema}
        if section.path == "point.*":
            target["properties"] |= {key.name: {**key.schema} for key in _keys_by_hand("point_type.*")}
    root["properties"]["unit"]["additionalProperties"] = {"type": "object"}
    root["properties"]["run"]["required"] = ["duration"]
    root["required"] = ["run"]
    root["anyOf"] = [{"required": ["line"]}, {"required": ["array"]}]  # all lines may be those of units
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "A scene of dropper_jax", **root}


def _section_object(root: Table, path: str) -> Table:
    """The object of a section, created if it is missing."""
    parent = root
    words = path.split(".")
    for word, following in pairwise([*words, ""]):
        if word in ("", "*"):
            continue
        made = {"type": "object", "properties": {}, "additionalProperties": False}
        if following == "*" and word != "unit":
            parent = parent["properties"].setdefault(word, {"type": "array", "items": made})["items"]
        else:
            parent = parent["properties"].setdefault(word, made)
    return parent


def _description(key: Key) -> str:
    words = key.meaning
    if key.unit != "-":
        words += f" [{key.unit}]"
    if key.default not in ("none", "needed"):
        words += f" (default: {key.default})"
    return words
