"""From a scene to a MoorDyn v2 input, with its wave and current files in the same folder."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.base.files import atomic_write
from dropper_jax.base.read import Table, Values
from dropper_jax.decks.reading.water import CURRENT, FREQUENCIES
from dropper_jax.decks.writing.bodies import body_numbers, body_tables, check_bodies, rule, section, words_of
from dropper_jax.decks.writing.differences import differences, moved_points
from dropper_jax.decks.writing.pieces import DIGITS, Piece, detachment, line_types, pieces
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.run.growth import overgrown
from dropper_jax.scene import LineSpec
from dropper_jax.sea.make import make_current, wave_components
from dropper_jax.sea.spec import CurrentSpec


def write_moordyn(
    scene: str | Path | Values | Scene,
    path: str | Path,
    *,
    dt: float | None = None,
    options: Values | None = None,
    force: bool = False,
) -> list[str]:
    """Write a system of lines as a MoorDyn v2 input; returns what the file cannot represent, one line each.

    Lines with unequal links become several lines joined at free points. Spar buoys become upright massless rods on
    bodies that cannot rotate. Bodies become bodies with massless rods, and moving points become coupled ones. The files
    of waves and current have the names that MoorDyn expects, `wave_frequencies.txt` and `current_profile.txt`, in the
    same folder. The names of other files contain that of `path`.

    Args:
        scene: lines of elastic links (`rope` or `elastic`).
        path: the file to write.
        dt: MoorDyn's time step [s] if it must be smaller than the scene's: its schemes are explicit.
        options: further MoorDyn options by name, such as tScheme.
        force: replace existing files of waves and current that differ.

    Raises:
        SceneError: rigid links, links without a diameter, a scene that is not a system of lines, bodies that MoorDyn
            does not support, or a file of waves or current of another input in the folder.
    """
    given = load_scene(scene)
    scene = overgrown(given)
    path = Path(path)
    _check_scene(scene)
    check_bodies(scene)
    notes = differences(dataclasses.replace(scene, season=given.season))
    parts = [pieces(scene, i) for i in range(len(scene.lines))]
    options = options or {}
    text = [*_front(scene, parts), *_tables(scene, parts, path), *_options(scene, path, dt, options), *_outputs(parts)]
    files = {path.parent / name: words for name, words in _files(scene, parts, path).items()}
    for file, words in files.items():
        if file.name in (FREQUENCIES, CURRENT) and not force and file.exists() and file.read_text() != words:
            raise SceneError(
                f"{file}: exists and differs. MoorDyn requires this name, so the file may belong to another input; "
                "use another folder, or --force to replace it"
            )
    for file, words in files.items():
        atomic_write(file, words)
    atomic_write(path, "\n".join(text) + "\n")
    return notes


@raises_first
def _check_scene(scene: Scene) -> Iterator[Check]:
    yield (
        not scene.branched or any(line.rigid for line in scene.lines),
        "scene: MoorDyn's lines are elastic. Use a system of lines with EA (a line with a [[line_type]])",
    )
    yield (
        displaced_diameter(scene.line, scene) is None,
        "line.diameter: missing; MoorDyn needs the diameter of every line [m]",
    )
    yield (
        scene.line.outer_diameter is not None,
        "line.outer_diameter: MoorDyn has one diameter, for buoyancy and for drag. Scale cdn and can to `diameter` "
        "instead",
    )
    for i, buoy in enumerate(scene.buoys):
        yield (
            any(other.point == buoy.point for other in scene.buoys[:i]),
            f"buoy.{i}.point: {buoy.point!r} carries two buoys; MoorDyn's rods need a body each",
        )


def _front(scene: Scene, parts: list[list[Piece]]) -> Iterator[str]:
    """Free text: values without a counterpart in MoorDyn."""
    yield rule("MoorDyn input, written by dropper-jax")
    yield f"! name = {json.dumps(scene.name)}"
    yield f"! description = {json.dumps(' '.join(scene.description.split()))}"
    if scene.notes:
        yield f"! notes = {json.dumps(scene.notes)}"
    for key, value in scene.to_dict()["run"].items():
        yield f"! run.{key} = {json.dumps(value)}"
    if any(line.axial_law == "damped_rope" for line in scene.lines):
        yield '! law = "damped_rope"'  # the axial law of MoorDyn's lines; by default they become ropes when read
    if whole := _lines_in_pieces(scene, parts):
        yield f"! pieces = {json.dumps(whole)}"


def _lines_in_pieces(scene: Scene, parts: list[list[Piece]]) -> list[list[str]]:
    """Lines that the file has in pieces: the name of each, then those of its pieces."""
    found: dict[str, list[str]] = {}
    for line, part in zip(scene.lines, parts, strict=True):
        name = line.piece_of or (line.name if len(part) > 1 else None)
        if name is not None:
            found.setdefault(name, []).extend(_names(line, part))
    return [[name, *own] for name, own in found.items()]


def _tables(scene: Scene, parts: list[list[Piece]], path: Path) -> Iterator[str]:
    kinds = line_types(parts)
    types = []
    for ((diameter, mass, stiffness, *rest), table), name in kinds.items():
        axial = stiffness if table is None else _table_file(path, name)
        types.append(words_of(name, diameter, mass, axial, *rest))
    head = "TypeName Diam Mass/m EA BA/-zeta EI Cd Ca CdAx CaAx"
    yield from section("LINE TYPES", head, "(name) (m) (kg/m) (N) (N-s/-) (N-m^2) (-) (-) (-) (-)", types)
    yield from body_tables(scene)
    words = {buoy.point: f"R{i + 1}A" for i, buoy in enumerate(scene.buoys)}
    rows = []
    moved = moved_points(scene)
    bodies = body_numbers(scene)
    for point in scene.points:
        if point.name in words:
            continue
        words[point.name] = str(len(rows) + 1)
        if point.is_free:
            kind = "Free"
        elif point.name in moved:
            kind = "Coupled"
        else:
            kind = "Fixed"
        position = point.position
        if point.on in bodies:
            kind = f"Body{bodies[point.on]}"
            position = next(body.attachments[point.name] for body in scene.bodies if body.name == point.on)
        body = [point.mass, point.volume, point.drag_area, point.added_mass]
        rows.append(_point(len(rows) + 1, kind, position, body, point.name))
    lines = []
    first: dict[str, int] = {}
    for line, part in zip(scene.lines, parts, strict=True):
        _join(scene, line, part, words, rows)
        first[line.name] = len(lines) + 1
        ends = [line.start, *_joints(line, part), line.end]
        for i, (name, piece) in enumerate(zip(_names(line, part), part, strict=True)):
            row = (len(lines) + 1, kinds[piece.kind], words[ends[i]], words[ends[i + 1]], piece.length, piece.links)
            lines.append(words_of(*row, "-", f" ! name: {name}"))
    head = "ID Attachment X Y Z Mass Volume CdA Ca"
    yield from section("POINTS", head, "(#) (word/ID) (m) (m) (m) (kg) (m^3) (m^2) (-)", rows)
    head = "ID LineType AttachA AttachB UnstrLen NumSegs LineOutputs"
    yield from section("LINES", head, "(#) (name) (ID) (ID) (m) (-) (-)", lines)
    yield from _failures(scene, parts, words, first)


def _names(line: LineSpec, part: list[Piece]) -> list[str]:
    """Names of the stretches of a line."""
    if len(part) == 1:
        return [line.name]
    return [f"{line.name}-{i + 1}" for i in range(len(part))]


def _joints(line: LineSpec, part: list[Piece]) -> list[str]:
    """Names of the points between the stretches of a line."""
    return [f"{line.name}-{i + 1}" for i in range(len(part) - 1)]


def _failures(scene: Scene, parts: list[list[Piece]], words: dict[str, str], first: dict[str, int]) -> Iterator[str]:
    """Lines that detach from a point at a time or a tension; `first` numbers the first stretch of each line."""
    rows = []
    for failure in scene.failures:
        position = detachment(scene, failure)
        if position is None:
            continue
        i, line = next((i, line) for i, line in enumerate(scene.lines) if line.name == failure.line)
        ends = [line.start, *_joints(line, parts[i]), line.end]
        point = words[ends[position.stretch + (not position.first)]]
        time = failure.time or 0.0
        load = failure.load or 0.0
        if failure.load is None and failure.time is None:
            load = line.breaking_load[failure.link - 1]
        rows.append(words_of(len(rows) + 1, point, first[line.name] + position.stretch, float(time), float(load)))
    if rows:
        yield from section("FAILURE", "ID Point Lines FailTime FailTen", "(#) (#) (,) (s) (N)", rows)


def _point(number: int, kind: str, position: np.ndarray, body: list[float | None], name: str) -> str:
    return words_of(number, kind, *position, *(float(x or 0.0) for x in body), f" ! name: {name}")


def _join(scene: Scene, line: LineSpec, part: list[Piece], words: dict[str, str], rows: list[str]) -> None:
    """Free points between the stretches of a line, on the straight line between its ends."""
    start = scene.point(line.start).position
    end = scene.point(line.end).position
    along = np.cumsum([piece.length for piece in part]) / sum(piece.length for piece in part)
    for name, share in zip(_joints(line, part), along[:-1], strict=True):
        if name in words:
            raise SceneError(f"point {name!r}: this name is needed for a joint of line {line.name!r}. Use another name")
        words[name] = str(len(rows) + 1)
        rows.append(_point(len(rows) + 1, "Free", start + share * (end - start), [None] * 4, name))


def _options(scene: Scene, path: Path, dt: float | None, more: Values) -> Iterator[str]:
    run = scene.run
    sea = scene.sea
    bed = scene.effects.get("seabed")
    depth = sea.depth if sea is not None else (bed or {}).get("depth")
    values: Table = {
        "dtM": run.step if dt is None else dt,
        "dtOut": run.step * run.save_every,
        "g": scene.gravity,
        "rho": 0.0 if sea is None else sea.density,
        "WtrDpth": depth if depth is not None else _below(scene),
    }
    if bed is not None:
        values |= {"kBot": bed["stiffness"], "cBot": bed["damping"]}
        if bed["bed_x"] is not None:
            values["SeafloorFile"] = f"{path.stem}-seafloor.txt"
    if "seabed_friction" in scene.effects:
        friction = scene.effects["seabed_friction"]
        values |= {"FrictionCoefficient": friction["kinetic"], "FricDamp": friction["damping"]}
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
    yield rule("OPTIONS")
    for key, value in {**values, **more}.items():
        yield words_of(value if isinstance(value, int | str) else float(value), key)


def _below(scene: Scene) -> float:
    """A depth [m] that nothing reaches, for a scene without seabed."""
    return 10.0 * (sum(line.total for line in scene.lines) + max(np.max(np.abs(p.position)) for p in scene.points))


def _outputs(parts: list[list[Piece]]) -> Iterator[str]:
    yield rule("OUTPUTS")
    for i in range(sum(map(len, parts))):
        yield from (f"FairTen{i + 1}", f"AnchTen{i + 1}")
    yield rule("need this line")


def _table_file(path: Path, name: str) -> str:
    return f"{path.stem}-{name}-axial.txt"


def _files(scene: Scene, parts: list[list[Piece]], path: Path) -> dict[str, str]:
    """Text of the accompanying files, by name."""
    found = {}
    sea = scene.sea
    bed = scene.effects.get("seabed")
    for (_, table), name in line_types(parts).items():
        if table is not None:
            rows = [words_of(*row) for row in table]
            head = [f"--- axial law of {name} ---", "Strain Tension", "(-) (N)"]
            found[_table_file(path, name)] = "\n".join([*head, *rows])  # MoorDyn rejects an empty last line
    if sea is not None and sea.waves is not None:
        drawn = wave_components(sea.waves, sea.depth, sea.gravity)
        found[FREQUENCIES] = _waves_text(*(np.asarray(values, float) for values in drawn))
    if sea is not None and sea.current is not None:
        current = make_current(sea.current)
        found[CURRENT] = current_text(sea.current, lambda z: np.asarray(current.profile(z, sea.depth)), sea.depth)
    if bed is not None and bed["bed_x"] is not None:
        x = np.asarray(bed["bed_x"], float)
        y = np.asarray(bed["bed_y"], float)
        z = np.asarray(bed["bed_depth"], float)
        rows = [words_of(a, b, -c) for (a, b), c in zip(product(x, y), z, strict=True)]
        head = [f"{len(x)} {len(y)}", words_of(*x), words_of(*y)]
        found[f"{path.stem}-seafloor.txt"] = "\n".join([*head, *rows]) + "\n"
    return found


def _waves_text(amplitude: np.ndarray, omega: np.ndarray, phase: np.ndarray, direction: np.ndarray) -> str:
    """Text of the frequency file for components (c,) of this package [m], [rad/s], [rad], [rad]."""
    turn = 0.5 * np.pi - phase
    table = np.stack([omega, amplitude * np.cos(turn), amplitude * np.sin(turn), direction * np.ones_like(omega)], 1)
    return "\n".join(["0.0 0.0 0.0 0.0", *(words_of(*row) for row in table)]) + "\n"


def current_text(spec: CurrentSpec, profile: Callable[[np.ndarray], np.ndarray], depth: float) -> str:
    """Text of the current file: a table unchanged, or a formula at heights that become dense towards the seabed."""
    if spec.heights is None:
        heights = depth * (np.linspace(0.0, 1.0, 61) ** 2 - 1.0)
    else:
        heights = spec.heights
    rows = zip(heights, profile(np.asarray(heights, float)), strict=True)
    lines = ["----- MoorDyn steady currents file -----", "z ux uy uz", "(m) (m/s) (m/s) (m/s)"]
    return "\n".join([*lines, *(words_of(float(z), *map(float, u)) for z, u in rows)]) + "\n"
