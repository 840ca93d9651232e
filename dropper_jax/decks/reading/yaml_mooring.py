"""The mooring section of MoorPy's and RAFT's YAML files as the plain values of a scene; needs the extra `yaml`."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from types import ModuleType

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, Table, read_number
from dropper_jax.base.records import column
from dropper_jax.decks.reading.reader import DEFAULT_DURATION, DEFAULT_STEP, read_moordyn
from dropper_jax.decks.reading.sections import is_number, read_input

SUFFIXES = (".yaml", ".yml")
#: Number of links of each line, which these files do not give.
LINKS_PER_LINE = 20
#: Keys of a line type: here, in the file, and whether they are required.
TYPE = (
    ("diameter", "diameter", True),
    ("mass", "mass_density", True),
    ("EA", "stiffness", True),
    ("breaking_load", "breaking_load", False),
    ("cdn", "transverse_drag", False),
    ("cdt", "tangential_drag", False),
    ("can", "transverse_added_mass", False),
    ("cat", "tangential_added_mass", False),
)
#: Kinds of points by parts of their words, in the order in which MoorPy looks for them.
KINDS = {
    "anch": "fixed",
    "fix": "fixed",
    "body": "body",
    "fair": "vessel",
    "ves": "vessel",
    "coupled": "vessel",
    "con": "free",
    "free": "free",
}


def read_yaml_mooring(path: str | Path, depth: float | None = None) -> Table:
    """The plain values of the scene of a YAML file of MoorPy, or of the `mooring` of a RAFT file.

    Lines are tension-only ropes of their type, with `diameter` that of the displaced volume; points of a vessel are
    fixed. Contents of the file that the scene lacks are listed under `notes`. If the file refers to a MoorDyn file,
    that is read.

    Args:
        depth: depth of the water [m], if the file has none.

    Raises:
        SceneError: one line, with the path inside the file.
    """
    path = Path(path)
    yaml = _yaml()
    text = read_input(path)
    try:
        found = _scene(_parsed(yaml, text), depth)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    if "file" in found:
        return read_moordyn(path.parent / str(found["file"]), depth)
    return {**found, "name": path.stem, "notes": [f"{path.name}: {note}" for note in found["notes"]]}


def _yaml() -> ModuleType:
    try:
        return importlib.import_module("yaml")
    except ImportError:
        raise SceneError("yaml is not installed. Use pip install 'dropper-jax[yaml]'") from None


def _parsed(yaml: ModuleType, text: str) -> Table:
    try:
        found = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = ""
        if mark is not None:
            where = f"line {mark.line + 1}: "
        raise SceneError(f"{where}YAML syntax: {getattr(error, 'problem', None) or 'too deep'}") from None
    return _table(found, "the file")


def _scene(table: Table, depth: float | None) -> Table:
    """The values of the scene, or the `file` that describes it."""
    notes: list[str] = []
    mooring = table
    site = {}
    before = ""
    if "mooring" in table:
        mooring = _table(table["mooring"], "mooring")
        site = _table(table.get("site") or {}, "site")
        before = "mooring."
        _note_ignored(notes, "", table, ("mooring", "site"))
        _note_ignored(notes, "site.", site, ("water_depth", "rho_water", "g"))
    if mooring.get("file"):
        return {"file": mooring["file"]}
    _note_ignored(notes, before, mooring, ("water_depth", "rho", "water_density", "points", "lines", "line_types"))
    deep = _depth({**site, **mooring}, depth)
    density = _first((mooring, "rho"), (mooring, "water_density"), (site, "rho_water"), default=SEA_WATER)
    gravity = _first((site, "g"), default=GRAVITY)
    types = _entries_by_name(mooring, "line_types", partial(_type, notes=notes))
    points = _entries_by_name(mooring, "points", partial(_point, notes=notes))
    lines = _entries_by_name(mooring, "lines", partial(_line, types=types, points=points, notes=notes))
    ends = set(column(lines.values(), "from")) | set(column(lines.values(), "to"))
    notes += [f"point {name!r} is not represented: no line ends there" for name in points if name not in ends]
    notes.append(
        f"the file has no links, time step or duration: {LINKS_PER_LINE} links per line, {DEFAULT_STEP:g} s and "
        f"{DEFAULT_DURATION:g} s are used"
    )
    used = set(column(lines.values(), "type"))
    return {
        "description": "",
        "run": {"dt": DEFAULT_STEP, "duration": DEFAULT_DURATION},
        "line_type": [kind for name, kind in types.items() if name in used],
        "point": [point for name, point in points.items() if name in ends],
        "line": list(lines.values()),
        "effects": {
            "weight": {"gravity": gravity},
            "buoyancy": {},
            "morison_drag": {},
            "morison_inertia": {},
            "seabed": {"stiffness": 3.0e6, "damping": 3.0e5},  # [Pa/m], [Pa s/m]: MoorDyn's
        },
        "sea": {"depth": deep, "density": density, "gravity": gravity},
        "notes": notes,
    }


def _table(value: Plain, at: str) -> Table:
    if not isinstance(value, dict):
        raise SceneError(f"{at}: is not a table; allowed: a mooring of MoorPy or RAFT")
    return value


def _entries_by_name(mooring: Table, key: str, read: Callable[[Table, str], Table]) -> dict[str, Table]:
    """Entries of a list by their names."""
    rows = mooring.get(key)
    if not isinstance(rows, list) or not rows:
        raise SceneError(f"{key}: missing; needed: a list with at least one entry")
    found: dict[str, Table] = {}
    for i, row in enumerate(rows):
        at = f"{key}.{i}"
        _table(row, at)
        name = row.get("name", f"{key.rstrip('s')}-{i + 1}")
        if not isinstance(name, (str, int)) or str(name) in found:
            raise SceneError(f"{at}.name: {name!r} is duplicate or not a name; allowed: a unique name")
        found[str(name)] = {"name": str(name), **read({**row, "name": str(name)}, at)}
    return found


def _type(row: Table, at: str, notes: list[str]) -> Table:
    _note_ignored(notes, f"{at}.", row, ("name", *(theirs for _, theirs, _ in TYPE)))
    found = {}
    for ours, theirs, needed in TYPE:
        path = f"{at}.{theirs}"
        limit = "above" if needed else "low"
        if theirs in row:
            found[ours] = _number(row[theirs], path, **{limit: 0.0})
        elif needed:
            raise SceneError(f"{path}: missing; needed: a number")
    if found.get("breaking_load") == 0.0:
        del found["breaking_load"]
    zero = {ours: theirs for ours, theirs, _ in TYPE[4:] if ours not in found}
    if zero:
        notes.append(f"{at}: {', '.join(zero.values())} are set to 0, as in MoorPy: these lines have no such forces")
    return {**found, **dict.fromkeys(zero, 0.0)}


def _point(row: Table, at: str, notes: list[str]) -> Table:
    _note_ignored(notes, f"{at}.", row, ("name", "type", "location", "mass", "volume"))
    position = row.get("location")
    if not isinstance(position, list) or len(position) != 3:
        raise SceneError(f"{at}.location: {position!r} is not a position; allowed: [x, y, z] in m")
    found: Table = {"position": [_number(x, f"{at}.location") for x in position]}
    given = str(row.get("type", "")).lower()
    kind = next((kind for part, kind in KINDS.items() if part in given), None)
    if kind is None:
        raise SceneError(f"{at}.type: {given!r} is unknown; allowed: fixed, vessel, free")
    if kind == "body":
        raise SceneError(
            f"{at}.type: {given!r} is on a body, which these files do not describe; allowed: fixed, vessel, free"
        )
    if kind == "vessel":
        notes.append(
            f"{at}: {row['name']!r} is on the vessel: it is fixed; use [[vessel]] to move such points together"
        )
    if kind == "free":
        found["kind"] = "free"
        found |= {key: _number(row[key], f"{at}.{key}", low=0.0) for key in ("mass", "volume") if row.get(key)}
    return found


def _line(row: Table, at: str, types: Iterable[str], points: Iterable[str], notes: list[str]) -> Table:
    _note_ignored(notes, f"{at}.", row, ("name", "type", "length", "endA", "endB"))
    found = {}
    for ours, theirs, known in (("type", "type", types), ("from", "endA", points), ("to", "endB", points)):
        name = str(row.get(theirs))
        if name not in known:
            raise SceneError(f"{at}.{theirs}: {name!r} is not in the file; {nearest(name, known)}")
        found[ours] = name
    if "length" not in row:
        raise SceneError(f"{at}.length: missing; needed: a number > 0 m")
    return {**found, "length": _number(row["length"], f"{at}.length", above=0.0), "links": LINKS_PER_LINE}


def _number(value: Plain, at: str, **limits: float) -> float:
    """A finite number; PyYAML reads `1e8`, without a point, as text."""
    if isinstance(value, str) and is_number(value):
        value = float(value)
    return read_number(value, at, limits)


def _first(*tables: tuple[Table, str], default: float) -> float:
    """The first of these that exists."""
    for table, key in tables:
        if key in table:
            return _number(table[key], key, above=0.0)
    return default


def _depth(given: Table, depth: float | None) -> float:
    if "water_depth" not in given:
        if depth is None:
            raise SceneError("water_depth: missing; needed: > 0 m, in the file or as --depth")
        return _number(depth, "--depth", above=0.0)
    if depth is not None:
        raise SceneError(f"--depth: {depth:g} m, but the file gives its own. Remove --depth")
    return _number(given["water_depth"], "water_depth", above=0.0)


def _note_ignored(notes: list[str], before: str, table: Table, read_keys: tuple[str, ...]) -> None:
    """Add a note with the keys of a table that are not read."""
    keys = [f"{before}{key}" for key in table if key not in read_keys]
    if keys:
        notes.append(f"not read: {', '.join(keys)}")
