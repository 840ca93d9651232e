"""The mooring section of MoorPy's and RAFT's YAML files as the plain values of a scene; needs the extra `yaml`."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, Table
from dropper_jax.decks.reading.reader import DEFAULT_DURATION, DEFAULT_STEP, read_moordyn
from dropper_jax.decks.reading.sections import read_input

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
#: First letters of the words for kinds of points, as MoorPy recognises them.
HELD = ("anch", "fix")
VESSEL = ("fair", "ves", "coupled")
FREE = ("con", "free")


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
    table = _load(path)
    notes: list[str] = []
    mooring = table
    site = {}
    if "mooring" in table:
        mooring = _table(path, table["mooring"], "mooring")
        site = _table(path, table.get("site") or {}, "site")
        _note_ignored(notes, "", table, ("mooring", "site"))
        _note_ignored(notes, "site.", site, ("water_depth", "rho_water", "g"))
    if mooring.get("file"):
        return read_moordyn(path.parent / str(mooring["file"]), depth)
    before = "mooring." if mooring is not table else ""
    _note_ignored(notes, before, mooring, ("water_depth", "rho", "water_density", "points", "lines", "line_types"))
    deep = _depth(path, mooring, site, depth)
    density = _first(path, (mooring, "rho"), (mooring, "water_density"), (site, "rho_water"), default=SEA_WATER)
    gravity = _first(path, (site, "g"), default=GRAVITY)
    types = _entries_by_name(path, mooring, "line_types", lambda row, at: _type(path, row, at, notes))
    points = _entries_by_name(path, mooring, "points", lambda row, at: _point(path, row, at, notes))
    lines = _entries_by_name(path, mooring, "lines", lambda row, at: _line(path, row, at, types, points, notes))
    ends = {line[key] for line in lines.values() for key in ("from", "to")}
    notes += [f"point {name!r} is not represented: no line ends there" for name in points if name not in ends]
    notes.append(
        f"the file has no links, time step or duration: {LINKS_PER_LINE} links per line, {DEFAULT_STEP:g} s and "
        f"{DEFAULT_DURATION:g} s are used"
    )
    return {
        "name": path.stem,
        "description": "",
        "run": {"dt": DEFAULT_STEP, "duration": DEFAULT_DURATION},
        "line_type": [kind for name, kind in types.items() if any(n["type"] == name for n in lines.values())],
        "point": [point for name, point in points.items() if name in ends],
        "line": list(lines.values()),
        "effects": {
            **{"weight": {"gravity": gravity}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}},
            "seabed": {"stiffness": 3.0e6, "damping": 3.0e5},  # [Pa/m], [Pa s/m]: MoorDyn's
        },
        "sea": {"depth": deep, "density": density, "gravity": gravity},
        "notes": [f"{path.name}: {note}" for note in notes],
    }


def _load(path: Path) -> Table:
    try:
        yaml = importlib.import_module("yaml")
    except ImportError:
        raise SceneError("yaml is not installed. Use pip install 'dropper-jax[yaml]'") from None
    text = read_input(path)
    try:
        found = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = ""
        if mark is not None:
            where = f"line {mark.line + 1}: "
        raise SceneError(f"{path}: {where}YAML syntax: {getattr(error, 'problem', None) or 'too deep'}") from None
    return _table(path, found, "the file")


def _table(path: Path, value: Plain, at: str) -> Table:
    if not isinstance(value, dict):
        raise SceneError(f"{path}: {at}: is not a table; allowed: a mooring of MoorPy or RAFT")
    return value


def _entries_by_name(path: Path, mooring: Table, key: str, read: Callable[[Table, str], Table]) -> dict[str, Table]:
    """Entries of a list by their names."""
    rows = mooring.get(key)
    if not isinstance(rows, list) or not rows:
        raise SceneError(f"{path}: {key}: missing; needed: a list with at least one entry")
    found: dict[str, Table] = {}
    for i, row in enumerate(rows):
        at = f"{key}.{i}"
        _table(path, row, at)
        name = row.get("name", f"{key.rstrip('s')}-{i + 1}")
        if not isinstance(name, (str, int)) or str(name) in found:
            raise SceneError(f"{path}: {at}.name: {name!r} is duplicate or not a name; allowed: a unique name")
        found[str(name)] = {"name": str(name), **read(row, at)}
    return found


def _type(path: Path, row: Table, at: str, notes: list[str]) -> Table:
    _note_ignored(notes, f"{at}.", row, ("name", *(theirs for _, theirs, _ in TYPE)))
    found = {}
    for ours, theirs, needed in TYPE:
        if theirs in row:
            found[ours] = _number(path, row[theirs], f"{at}.{theirs}", 0.0, needed)
        elif needed:
            raise SceneError(f"{path}: {at}.{theirs}: missing; needed: a number")
    if not found.get("breaking_load"):
        found.pop("breaking_load", None)
    zero = {ours: theirs for ours, theirs, _ in TYPE[4:] if ours not in found}
    if zero:
        notes.append(f"{at}: {', '.join(zero.values())} are set to 0, as in MoorPy: these lines have no such forces")
    return {**found, **dict.fromkeys(zero, 0.0)}


def _point(path: Path, row: Table, at: str, notes: list[str]) -> Table:
    _note_ignored(notes, f"{at}.", row, ("name", "type", "location", "mass", "volume"))
    position = row.get("location")
    if not isinstance(position, list) or len(position) != 3:
        raise SceneError(f"{path}: {at}.location: {position!r} is not a position; allowed: [x, y, z] in m")
    found: Table = {"position": [_number(path, x, f"{at}.location") for x in position]}
    kind = str(row.get("type", "")).lower()
    if any(word in kind for word in HELD):
        return found
    if "body" in kind:
        raise SceneError(
            f"{path}: {at}.type: {kind!r} is on a body, which these files do not describe; allowed: fixed, vessel, free"
        )
    if any(word in kind for word in VESSEL):
        notes.append(
            f"{at}: {row.get('name')!r} is on the vessel: it is fixed; use [[vessel]] to move such points together"
        )
        return found
    if not any(word in kind for word in FREE):
        raise SceneError(f"{path}: {at}.type: {kind!r} is unknown; allowed: fixed, vessel, free")
    bodies = {key: _number(path, row[key], f"{at}.{key}", 0.0) for key in ("mass", "volume") if row.get(key)}
    return {**found, "kind": "free", **bodies}


def _line(path: Path, row: Table, at: str, types: Iterable[str], points: Iterable[str], notes: list[str]) -> Table:
    _note_ignored(notes, f"{at}.", row, ("name", "type", "length", "endA", "endB"))
    found = {}
    for ours, theirs, known in (("type", "type", types), ("from", "endA", points), ("to", "endB", points)):
        name = str(row.get(theirs))
        if name not in known:
            raise SceneError(f"{path}: {at}.{theirs}: {name!r} is not in the file; {nearest(name, known)}")
        found[ours] = name
    if "length" not in row:
        raise SceneError(f"{path}: {at}.length: missing; needed: a number > 0 m")
    return {**found, "length": _number(path, row["length"], f"{at}.length", 0.0, True), "links": LINKS_PER_LINE}


def _number(path: Path, value: Plain, at: str, low: float = -math.inf, open_low: bool = False) -> float:
    """A finite number; PyYAML reads `1e8`, without a point, as text."""
    found = math.nan
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        with suppress(ValueError):
            found = float(value)
    if not math.isfinite(found) or found < low or (open_low and found == low):
        if low == -math.inf:
            limit = ""
        else:
            limit = f" {'>' if open_low else '>='} {low:g}"
        raise SceneError(f"{path}: {at}: {value!r} is out of range or not a number; allowed: a number{limit}")
    return found


def _first(path: Path, *tables: tuple[Table, str], default: float) -> float:
    """The first of these that exists."""
    return next((_number(path, table[key], key, 0.0, True) for table, key in tables if key in table), default)


def _depth(path: Path, mooring: Table, site: Table, depth: float | None) -> float:
    given = {**site, **mooring}.get("water_depth", depth)
    if given is None:
        raise SceneError(f"{path}: water_depth: missing; needed: > 0 m, in the file or as --depth")
    if depth is not None and "water_depth" in {**site, **mooring}:
        raise SceneError(f"{path}: --depth: {depth:g} m, but the file gives its own. Remove --depth")
    return _number(path, given, "water_depth" if depth is None else "--depth", 0.0, True)


def _note_ignored(notes: list[str], before: str, table: Table, read_keys: tuple[str, ...]) -> None:
    """Add a note with the keys of a table that are not read."""
    keys = [f"{before}{key}" for key in table if key not in read_keys]
    if keys:
        notes.append(f"not read: {', '.join(keys)}")
