"""Every key of a scene, generated from its declaration: meaning, unit, range, default, source.

The scene reader checks against the same declarations (`base.fields.parameter`, `option`, `base.read.count`), so each
key is described once. Keys that are read by hand have their rows in `BY_HAND`.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from dropper_jax.axial import LAWS
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath, declared_fields, limits
from dropper_jax.integrators import INTEGRATORS, OPTIONS
from dropper_jax.load.paths import declared_sections

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
    schema: Mapping[str, Any] = dataclasses.field(default_factory=dict)

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
TABLE = {"type": "object"}
LIST = {"type": "array"}


def _by_hand(path: str, *rows: tuple[str, str, str, Mapping[str, Any]]) -> tuple[Key, ...]:
    return tuple(Key(f"{path}.{name}".lstrip("."), meaning, kind, schema=dict(s)) for name, meaning, kind, s in rows)


REPEAT = (
    "repeat",
    "counters to repeat over: {k = 60} is k = 1 to 60, {k = [0, 9]} a range; `{k}` in a text is replaced by the number",
    "table",
    TABLE,
)
#: Keys that are read by hand, by section.
BY_HAND: dict[str, tuple[Key, ...]] = {
    "": _by_hand(
        "",
        ("name", "name of the scene; default: that of its file", "text", TEXT),
        ("description", "what it is", "text", TEXT),
        ("notes", "remarks, repeated as warnings of every run", "list of texts", {**LIST, "items": TEXT}),
    ),
    "point.*": _by_hand("point.*", ("type", "name of a [[point_type]], or `library:NAME`", "text", TEXT), REPEAT),
    "buoy.*": _by_hand("buoy.*", REPEAT),
    "failure.*": _by_hand("failure.*", REPEAT),
    "line.*": _by_hand(
        "line.*",
        REPEAT,
        ("type", "name of a [[line_type]], or `library:NAME`; `length` is then that of the full line", "text", TEXT),
        ("sections", "sections one after another: {type, length [m], links}", "list of tables", LIST),
        ("attach", "points along the line: {point, at}, `at` the arc length from its first end [m]", "list", LIST),
        ("shelter", "factor on the current that reaches the line", "number, or a table over it", {}),
    ),
    "line.*.axial": _by_hand(
        "line.*.axial",
        ("law", f"axial law: {', '.join(LAWS)}; default: rope", "text", {"enum": list(LAWS)}),
        ("strain", "strains of a table (law tabulated), rising from 0", "list of numbers", LIST),
        ("tension", "tensions at those strains [N]", "list of numbers", LIST),
    ),
    "body.*": _by_hand(
        "body.*", ("attachments", "positions of points on it [m], in its axes, by their names", "table", TABLE)
    ),
    "vessel.*": _by_hand(
        "vessel.*",
        ("motion", "rows of surge, sway, heave [m], roll, pitch, yaw [rad] at `time`", "list of lists", LIST),
        ("attachments", "positions of points on it [m], in its axes, by their names", "table", TABLE),
    ),
    "vessel.*.rao": tuple(
        Key(f"vessel.*.rao.{motion}{end}", f"{what} of {motion} over elevation", "rows by heading", unit, schema={})
        for motion in ("surge", "sway", "heave", "roll", "pitch", "yaw")
        for end, what, unit in (
            ("", "amplitude", "m/m" if motion in ("surge", "sway", "heave") else "rad/m"),
            ("_phase", "phase", "rad"),
        )
    ),
    "growth": _by_hand(
        "growth",
        ("thickness", "thickness of the layer [m], a row for each month, a column for each depth", "rows", LIST),
    ),
    "sea": _by_hand("sea", ("packaged", "name of a packaged sea, whose values the scene may override", "text", TEXT)),
    "fit": _by_hand(
        "fit", ("free", "paths of parameters that a fit may change", "list of texts", {**LIST, "items": TEXT})
    ),
    "parameters": _by_hand("parameters", ("*", "a named number, or an expression of others", "number", NUMBER)),
    "point_type.*": _by_hand(
        "point_type.*",
        ("float", "volume of a float at the point [m^3]", "number", NUMBER),
        ("float_density", "density of its foam and shell [kg/m^3]; default 80", "number", NUMBER),
    ),
    "array.*": _by_hand(
        "array.*",
        ("of", "name of a [unit]", "text", TEXT),
        ("repeat", "counters with a count or [first, last] each", "table", TABLE),
        ("name", "prefix of the names of each unit", "text", TEXT),
        ("origin", "position of each unit [m]", "3 numbers or expressions", LIST),
        ("heading", "angle of the unit's x axis from the scene's [deg]", "number", NUMBER),
        ("shared", "points of a unit that are shared with others", "table", TABLE),
    ),
}
ABOUT = {
    "": "Keys at the top of the file.",
    "line.*.axial": "Axial law of the links of a line; rigid if omitted.",
    "fit": "Free parameters and sensors of fits of this scene (see docs/fits.md).",
    "parameters": "Named numbers; a text value that starts with `=` is an expression of them.",
    "unit.*": "Points, lines and buoys that belong together, placed by `[[array]]`.",
    "array.*": "Positions of units (see docs/longlines.md).",
    "point_type.*": "Common values of points of a kind, which points refer to by `type`.",
}


def sections() -> list[Section]:
    """All sections of a scene, with effects registered from outside."""
    return [_section(*row) for row in declared_sections()]


def _section(path: str, head: str, cls: type | None) -> Section:
    keys = [] if cls is None else list(_declared_keys(path, cls))
    if path == "run":
        keys += [_option(name, about) for name, about in OPTIONS.items()]
    if path in ("line.*.axial", "line_type.*"):
        names = {key.name for key in (*keys, *BY_HAND.get(path, ()))}
        own = {key.name: key for law in LAWS.values() for key in _declared_keys(path, law) if key.name not in names}
        keys += own.values()
    if path == "point_type.*":
        keys = [key for key in keys if key.name != "position"]
    about = ABOUT.get(path) or inspect.getdoc(cls) or ""
    return Section(path, head, _first(about), "" if cls is None else source_of(cls), (*keys, *BY_HAND.get(path, ())))


def _declared_keys(path: str, cls: type) -> Iterable[Key]:
    """Keys declared by a class."""
    for key, field in declared_fields(cls).items():
        about = field.metadata
        name = f"{path}.{key}"
        number = about["kind"] == "parameter"
        if number or about.get("type") is int:
            allowed = limits({**about, "unit": "-"})
        else:
            allowed = ""
        if about.get("choices"):
            allowed = ", ".join(map(str, about["choices"]))
        if number:
            kind = SHAPES[about["shape"]]
        else:
            kind = TYPES.get(about.get("type"), "text")
        yield Key(name, about["meaning"], kind, about.get("unit", "-"), allowed, _default(field), _schema(about))


def _option(name: str, about: Mapping[str, Any]) -> Key:
    takers = ", ".join(scheme for scheme, one in INTEGRATORS.items() if name in one.options())
    meaning = f"{about.get('meaning', name)} ({takers})"
    return Key(f"run.{name}", meaning, "number", "-", limits({**about, "unit": "-"}), "that of the scheme", NUMBER)


def _default(field: dataclasses.Field) -> str:
    match value := field.default:
        case dataclasses.MISSING:
            return "needed"
        case None | bool():
            return {None: "none", True: "true", False: "false"}[value]
        case tuple() | list() | np.ndarray():
            return str([float(x) if isinstance(x, int | float) else x for x in value])
        case float():
            return f"{value:g}"
    return str(value)


def _schema(about: Mapping[str, Any]) -> dict[str, Any]:
    """JSON Schema of a declared value; a text may be an expression of the scene's parameters."""
    if about["kind"] != "parameter":
        kinds = {int: {"type": ["integer", "string"]}, bool: {"type": "boolean"}, tuple: LIST, list: LIST}
        choices = {"enum": list(about["choices"])} if about.get("choices") else {}
        return {**kinds.get(about.get("type"), {} if choices else TEXT), **choices}
    number: dict[str, Any] = {"type": ["number", "string"]}
    if about.get("low") is not None:
        number["exclusiveMinimum" if about.get("open_low") else "minimum"] = about["low"]
    if about.get("high") is not None:
        number["maximum"] = about["high"]
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
    texts = [inspect.getdoc(cls) or "", sys.modules[cls.__module__].__doc__ or ""]
    found = [" ".join(match[0].split()) for text in texts for match in SOURCE.finditer(" ".join(text.split()))]
    return " ".join(dict.fromkeys(sentence.strip() for sentence in found if sentence.strip()))


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
        keys = [key for section in every for key in section.keys]
        hint = nearest(word, [*(s.path for s in every if s.path), *(k.path for k in keys), *(k.name for k in keys)])
        raise SceneError(
            f"--reference: {word!r} is not a key; {hint if not hint.startswith('known') else 'all: --reference'}"
        )
    return found


def _matches(path: str, word: str) -> bool:
    """Whether a path with `*` matches the word; list entries may be given by number, name or omitted."""
    plain = path.replace(".*", "")
    pattern = re.escape(path).replace(r"\*", r"[^.]+")
    return bool(path) and (word == plain or re.fullmatch(pattern, word) is not None)


def schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of a scene."""
    root: dict[str, Any] = {"type": "object", "properties": {}, "additionalProperties": False}
    for section in sections():
        target = _section_object(root, section.path)
        for key in section.keys:
            if key.name == "*":
                target["additionalProperties"] = dict(key.schema)
            else:
                target["properties"][key.name] = {"description": _description(key), **key.schema}
        if section.path == "point.*":
            target["properties"] |= {key.name: {**key.schema} for key in BY_HAND["point_type.*"]}
    root["properties"]["unit"]["additionalProperties"] = {"type": "object"}
    root["properties"]["run"]["required"] = ["duration"]
    root["required"] = ["run"]
    root["anyOf"] = [{"required": ["line"]}, {"required": ["array"]}]  # all lines may be those of units
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scene of dropper_jax",
        **root,
    }


def _section_object(root: dict[str, Any], path: str) -> dict[str, Any]:
    """The object of a section, created if it is missing."""
    parent = root
    words = path.split(".") if path else []
    for i, word in enumerate(words):
        if word == "*":
            continue
        listed = i + 1 < len(words) and words[i + 1] == "*" and word not in ("unit",)
        made = {"type": "object", "properties": {}, "additionalProperties": False}
        inner = parent["properties"].setdefault(word, {"type": "array", "items": made} if listed else made)
        parent = inner["items"] if listed else inner
    return parent


def _description(key: Key) -> str:
    unit = "" if key.unit == "-" else f" [{key.unit}]"
    return key.meaning + unit + ("" if key.default in ("none", "needed") else f" (default: {key.default})")
