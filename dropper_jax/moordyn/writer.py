"""From a scene to a MoorDyn v2 input, with its wave and current files beside it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.errors import SceneError
from dropper_jax.force_table import ForceTable
from dropper_jax.io import atomic_write
from dropper_jax.moordyn.differences import differences
from dropper_jax.moordyn.spar import SEGMENTS, UPRIGHT
from dropper_jax.moordyn.water import CURRENT, FREQUENCIES, current_text, waves_text
from dropper_jax.scene import Scene, load_scene
from dropper_jax.sea.checks import displaced_diameter
from dropper_jax.sections import BuoySpec, LineSpec

#: Digits of a value per metre that was stored per link: dividing by the link's length rounds the last ones.
DIGITS = 12
COEFFICIENTS = (
    ("morison_drag", "cdn"),
    ("morison_inertia", "can"),
    ("morison_drag", "cdt"),
    ("morison_inertia", "cat"),
)


@dataclass(frozen=True)
class Piece:
    """A stretch of equal links: the values of its line type, its number of links and its length [m].

    `table` holds the rows (strain, tension [N]) of a tabulated law; the type's EA has no say then.
    """

    type: tuple[float, ...]
    links: int
    length: float
    table: tuple[tuple[float, float], ...] | None = None

    @property
    def kind(self) -> tuple[Any, ...]:
        """What makes two stretches of one line type."""
        return (*self.type, self.table)


def write_moordyn(
    scene: str | Path | Mapping[str, Any] | Scene,
    path: str | Path,
    *,
    dt: float | None = None,
    options: Mapping[str, Any] | None = None,
) -> list[str]:
    """Write a system of lines as a MoorDyn v2 input; returns what the file cannot say, one line each.

    Lines of unequal links become several lines joined at free points. Spar buoys become upright massless rods on
    bodies that cannot turn. `wave_frequencies.txt` and `current_profile.txt` are written to the same folder.

    Args:
        scene: lines of elastic links (`rope` or `elastic`).
        path: the file to write.
        dt: MoorDyn's time step [s] where it must be smaller than the scene's: its schemes are explicit.
        options: further MoorDyn options by name, such as tScheme.

    Raises:
        SceneError: rigid links, links without a diameter, or a scene that is no system of lines.
    """
    scene, path = load_scene(scene), Path(path)
    if not scene.branched or any(line.rigid for line in scene.lines):
        raise SceneError(
            "scene: MoorDyn's lines are elastic; allowed: a system of lines with EA (a line with a [[line_type]])"
        )
    if displaced_diameter(scene.line, scene) is None:
        raise SceneError("line.diameter: missing; MoorDyn needs the diameter of every line [m]")
    for i, buoy in enumerate(scene.buoys):
        if any(other.point == buoy.point for other in scene.buoys[:i]):
            raise SceneError(f"buoy.{i}.point: {buoy.point!r} carries two buoys; MoorDyn's rods need a body each")
    notes = differences(scene)
    text = [*_front(scene), *_tables(scene), *_options(scene, dt, options or {}), *_outputs(scene)]
    for name, words in _files(scene).items():
        atomic_write(path.parent / name, words)
    atomic_write(path, "\n".join(text) + "\n")
    return notes


def _rule(words: str) -> str:
    return f"{'-' * 22} {words} {'-' * 40}"


def _value(x: Any) -> str:
    return repr(float(x))


def _front(scene: Scene) -> Iterator[str]:
    """Free text: what MoorDyn has no place for."""
    yield _rule("MoorDyn input, written by dropper-jax")
    yield f"! name = {json.dumps(scene.name)}"
    yield f"! description = {json.dumps(' '.join(scene.description.split()))}"
    for key, value in scene.to_dict()["run"].items():
        yield f"! run.{key} = {json.dumps(value)}"


def pieces(scene: Scene, index: int) -> list[Piece]:
    """Stretches of equal links of a line."""
    line = scene.lines[index]
    first = sum(other.links for other in scene.lines[:index])
    span = slice(first, first + line.links)
    total = scene.line.links

    def each(value: Any) -> np.ndarray:
        return np.broadcast_to(np.asarray(0.0 if value is None else value, float), (total,))[span]

    coefficients = [each(scene.effects.get(effect, {}).get(key)) for effect, key in COEFFICIENTS]
    damping = np.zeros(line.links) if line.axial_damping is None else line.axial_damping
    diameter = each(displaced_diameter(scene.line, scene))
    rows = np.stack([diameter, line.mass / line.length, line.EA, damping, *coefficients, line.length], axis=1)
    tables = [_rows(table) for table in line.tables] if line.tables is not None else [None] * line.links
    same = np.all(np.abs(rows[1:] - rows[:-1]) <= 10.0**-DIGITS * np.abs(rows[1:]), axis=1)
    same = same & np.array([a == b for a, b in pairwise(tables)], bool)
    cuts = [0, *(np.flatnonzero(~same) + 1), line.links]
    found = []
    for a, b in zip(cuts[:-1], cuts[1:], strict=True):
        kind = [float(x) for x in rows[a, :-1]]
        kind[1] = _short(kind[1])
        found.append(Piece(tuple(kind), int(b - a), _short(np.sum(line.length[a:b])), tables[a]))
    return found


def _rows(table: ForceTable) -> tuple[tuple[float, float], ...]:
    return tuple(zip(table.strain.tolist(), table.tension.tolist(), strict=True))


def _kinds(parts: list[list[Piece]]) -> dict[tuple[Any, ...], str]:
    """Names of the line types."""
    kinds: dict[tuple[Any, ...], str] = {}
    for piece in (piece for part in parts for piece in part):
        kinds.setdefault(piece.kind, f"type{len(kinds) + 1}")
    return kinds


def _short(x: float) -> float:
    return float(f"{x:.{DIGITS}g}")


def _tables(scene: Scene) -> Iterator[str]:
    parts = [pieces(scene, i) for i in range(len(scene.lines))]
    kinds = _kinds(parts)
    yield _rule("LINE TYPES")
    yield "TypeName Diam Mass/m EA BA/-zeta EI Cd Ca CdAx CaAx"
    yield "(name) (m) (kg/m) (N) (N-s/-) (N-m^2) (-) (-) (-) (-)"
    for (*values, table), name in kinds.items():
        words = [_value(x) for x in values]
        if table is not None:
            words[2] = _table_file(name)
        yield " ".join([name, *words[:4], "0.0", *words[4:]])
    if scene.buoys:
        yield from _buoys(scene)
    words = {buoy.point: f"R{i + 1}A" for i, buoy in enumerate(scene.buoys)}
    rows = []
    moved = scene.effects.get("end_motion", {}).get("point")
    for point in scene.points:
        if point.name in words:
            continue
        words[point.name] = str(len(rows) + 1)
        kind = "Free" if point.kind == "free" else "Coupled" if point.name == moved else "Fixed"
        body = [point.mass, point.volume, point.drag_area, point.added_mass]
        rows.append(_point(len(rows) + 1, kind, point.position, body, point.name))
    lines = []
    for line, part in zip(scene.lines, parts, strict=True):
        _join(scene, line, part, words, rows)
        ends = [line.start, *(f"{line.name}-{i + 1}" for i in range(len(part) - 1)), line.end]
        for i, piece in enumerate(part):
            name = line.name if len(part) == 1 else f"{line.name}-{i + 1}"
            begin, end = words[ends[i]], words[ends[i + 1]]
            row = [len(lines) + 1, kinds[piece.kind], begin, end, _value(piece.length), piece.links, "-"]
            lines.append(" ".join(str(x) for x in row) + f"  ! name: {name}")
    yield _rule("POINTS")
    yield "ID Attachment X Y Z Mass Volume CdA Ca"
    yield "(#) (word/ID) (m) (m) (m) (kg) (m^3) (m^2) (-)"
    yield from rows
    yield _rule("LINES")
    yield "ID LineType AttachA AttachB UnstrLen NumSegs LineOutputs"
    yield "(#) (name) (ID) (ID) (m) (-) (-)"
    yield from lines


def _point(number: int, kind: str, position: Any, body: list[float | None], name: str) -> str:
    return " ".join([str(number), kind, *(_value(x) for x in position), *(_value(x or 0.0) for x in body)]) + (
        f"  ! name: {name}"
    )


def _join(scene: Scene, line: LineSpec, part: list[Piece], words: dict[str, str], rows: list[str]) -> None:
    """Free points between the stretches of a line, on the straight line between its ends."""
    start, end = scene.point(line.start).position, scene.point(line.end).position
    along = np.cumsum([piece.length for piece in part]) / sum(piece.length for piece in part)
    for i, share in enumerate(along[:-1]):
        name = f"{line.name}-{i + 1}"
        if name in words:
            raise SceneError(f"point {name!r}: is needed for a joint of line {line.name!r}; allowed: another name")
        words[name] = str(len(rows) + 1)
        rows.append(_point(len(rows) + 1, "Free", start + share * (end - start), [None] * 4, name))


def _buoys(scene: Scene) -> Iterator[str]:
    yield _rule("ROD TYPES")
    yield "TypeName Diam Mass/m Cd Ca CdEnd CaEnd"
    yield "(name) (m) (kg/m) (-) (-) (-) (-)"
    for i, b in enumerate(scene.buoys):
        yield " ".join([f"buoy{i + 1}", _value(b.diameter), "0.0", *(_value(x) for x in (b.cdn, b.can, b.cdt, b.cat))])
    yield _rule("BODIES")
    yield "ID Attachment X0 Y0 Z0 r0 p0 y0 Mass CG I Volume CdA Ca"
    yield "(#) (word) (m) (m) (m) (deg) (deg) (deg) (kg) (m) (kg-m^2) (m^3) (m^2) (-)"
    for i, b in enumerate(scene.buoys):
        place = " ".join(_value(x) for x in _base(scene, b))
        yield f"{i + 1} Free {place} 0 0 0 {_value(b.mass)} 0 {_value(100 * UPRIGHT)} 0 0 0  ! name: {b.point}"
    yield _rule("RODS")
    yield "ID RodType Attachment Xa Ya Za Xb Yb Zb NumSegs RodOutputs"
    yield "(#) (name) (word/ID) (m) (m) (m) (m) (m) (m) (-) (-)"
    for i, b in enumerate(scene.buoys):
        yield f"{i + 1} buoy{i + 1} Body{i + 1} 0 0 0 0 0 {_value(b.height)} {SEGMENTS} -  ! name: {b.name}"


def _base(scene: Scene, buoy: BuoySpec) -> np.ndarray:
    """Where the buoy's point is; MoorDyn hangs lines on the base."""
    return scene.point(buoy.point).position


def _options(scene: Scene, dt: float | None, more: Mapping[str, Any]) -> Iterator[str]:
    run, sea, bed = scene.run, scene.sea, scene.effects.get("seabed")
    depth = sea.depth if sea is not None else (bed or {}).get("depth")
    values: dict[str, Any] = {
        "dtM": run.dt if dt is None else dt,
        "dtOut": run.dt * run.save_every,
        "g": scene.effects.get("weight", {}).get("gravity", 9.81 if sea is None else sea.gravity),
        "rho": 0.0 if sea is None else sea.density,
        "WtrDpth": depth if depth is not None else _below(scene),
    }
    if bed is not None:
        values.update({"kBot": bed["stiffness"], "cBot": bed["damping"]})
        if bed["bed_x"] is not None:
            values["SeafloorFile"] = "seafloor.txt"
    friction = scene.effects.get("seabed_friction")
    if friction is not None:
        values["FrictionCoefficient"] = friction["kinetic"]
        if friction["static"] is not None and friction["kinetic"] > 0.0:
            values["StatDynFricScale"] = float(f"{friction['static'] / friction['kinetic']:.{DIGITS}g}")
    if sea is not None and sea.waves is not None:
        values["WaveKin"] = 7
        if sea.ramp is not None:
            values["waveKin_rampT"] = sea.ramp
    if sea is not None and sea.current is not None:
        values["Currents"] = 1
    if scene.start.kind == "points":
        values["TmaxIC"] = 0
    yield _rule("OPTIONS")
    for key, value in {**values, **more}.items():
        yield f"{value if isinstance(value, int | str) else _value(value)} {key}"


def _below(scene: Scene) -> float:
    """A depth [m] that nothing reaches, where the scene has no bed."""
    return 10.0 * (sum(line.total for line in scene.lines) + max(np.max(np.abs(p.position)) for p in scene.points))


def _outputs(scene: Scene) -> Iterator[str]:
    yield _rule("OUTPUTS")
    for i in range(sum(len(pieces(scene, j)) for j in range(len(scene.lines)))):
        yield f"FairTen{i + 1}"
        yield f"AnchTen{i + 1}"
    yield _rule("need this line")


def _table_file(name: str) -> str:
    return f"{name}-axial.txt"


def _files(scene: Scene) -> dict[str, str]:
    """Text of the files beside the input, by name."""
    found, sea, bed = {}, scene.sea, scene.effects.get("seabed")
    for (*_, table), name in _kinds([pieces(scene, i) for i in range(len(scene.lines))]).items():
        if table is not None:
            rows = [f"{_value(e)} {_value(pull)}" for e, pull in table]
            head = [f"--- axial law of {name} ---", "Strain Tension", "(-) (N)"]
            found[_table_file(name)] = "\n".join([*head, *rows])  # MoorDyn takes an empty last line for a bad row
    if sea is not None and sea.waves is not None:
        from dropper_jax.sea.make import wave_components

        drawn = wave_components(sea.waves, sea.depth, sea.gravity)
        arrays = (drawn.amplitude, drawn.omega, drawn.phase, drawn.direction)
        found[FREQUENCIES] = waves_text(*(np.asarray(a, float) for a in arrays))
    if sea is not None and sea.current is not None:
        from dropper_jax.sea.make import make_current

        current = make_current(sea.current)
        found[CURRENT] = current_text(sea.current, lambda z: np.asarray(current.profile(z, sea.depth)), sea.depth)
    if bed is not None and bed["bed_x"] is not None:
        x, y, z = (np.asarray(bed[key], float) for key in ("bed_x", "bed_y", "bed_depth"))
        rows = [f"{_value(a)} {_value(b)} {_value(-c)}" for (a, b), c in zip(product(x, y), z, strict=True)]
        head = [f"{len(x)} {len(y)}", *(" ".join(_value(v) for v in axis) for axis in (x, y))]
        found["seafloor.txt"] = "\n".join([*head, *rows]) + "\n"
    return found
