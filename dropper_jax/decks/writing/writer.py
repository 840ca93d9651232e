"""From a scene to a MoorDyn v2 input, with its wave and current files in the same folder."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.base.files import atomic_write
from dropper_jax.base.read import Plain, Table, Values
from dropper_jax.base.records import by_name, names_of
from dropper_jax.decks.reading.water import CURRENT, FREQUENCIES
from dropper_jax.decks.writing.bodies import body_numbers, body_tables, check_bodies, rule, section, words_of
from dropper_jax.decks.writing.differences import differences, has_several_laws, moved_points
from dropper_jax.decks.writing.line_types import name_line_types, short
from dropper_jax.decks.writing.stretches import Stretch, detachment, stretches
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.modelling.growth import overgrown
from dropper_jax.sea.current_spec import CurrentSpec
from dropper_jax.sea.make import make_current, wave_components


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
    parts = stretches(scene)
    front = [*_front(scene, parts), *_tables(scene, parts, path)]
    text = [*front, *_options(scene, path, dt, options or {}), *_outputs(len(parts))]
    files = {path.parent / name: words for name, words in _files(scene, parts, path)}
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
        scene.single_line is not None or any(line.rigid for line in scene.lines),
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


def _front(scene: Scene, parts: list[Stretch]) -> Iterator[str]:
    """Free text: values without a counterpart in MoorDyn."""
    yield rule("MoorDyn input, written by dropper-jax")
    yield f"! name = {_toml(scene.name)}"
    yield f"! description = {_toml(' '.join(scene.description.split()))}"
    if scene.notes:
        yield f"! notes = {_toml(scene.notes)}"
    for key, value in scene.to_dict()["run"].items():
        yield f"! run.{key} = {_toml(value)}"
    if any(line.axial_law == "damped_rope" for line in scene.lines) and not has_several_laws(scene):
        yield '! law = "damped_rope"'  # the axial law of MoorDyn's lines; by default they become ropes when read
    whole: dict[str, list[str]] = {}
    for part in parts:
        name = part.line.piece_of or part.line.name
        if name != part.name:
            whole.setdefault(name, [name]).append(part.name)
    if whole:  # lines that the file has in pieces: the name of each, then those of its pieces
        yield f"! pieces = {_toml(list(whole.values()))}"


def _toml(value: Plain) -> str:
    """A value as TOML, in which JSON's escapes of characters above U+FFFF are invalid."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # a control character only in TOML


def _tables(scene: Scene, parts: list[Stretch], path: Path) -> Iterator[str]:
    kinds = name_line_types(part.kind for part in parts)
    types = []
    for ((diameter, mass, stiffness, *rest), table), name in kinds.items():
        axial = stiffness if table is None else _table_file(path, name)
        types.append(words_of(name, diameter, mass, axial, *rest))
    head = "TypeName Diam Mass/m EA BA/-zeta EI Cd Ca CdAx CaAx"
    yield from section("LINE TYPES", head, "(name) (m) (kg/m) (N) (N-s/-) (N-m^2) (-) (-) (-) (-)", types)
    yield from body_tables(scene)
    rows = [*_points(scene), *_joints(scene, parts)]
    words = {buoy.point: f"R{i}A" for i, buoy in enumerate(scene.buoys, start=1)}
    words |= {name: str(i) for i, (name, _) in enumerate(rows, start=1)}
    points = [f"{i} {row}  ! name: {name}" for i, (name, row) in enumerate(rows, start=1)]
    lines = []
    for i, part in enumerate(parts, start=1):
        row = (i, kinds[part.kind], words[part.start], words[part.end], part.length, part.links)
        lines.append(words_of(*row, "-", f" ! name: {part.name}"))
    head = "ID Attachment X Y Z Mass Volume CdA Ca"
    yield from section("POINTS", head, "(#) (word/ID) (m) (m) (m) (kg) (m^3) (m^2) (-)", points)
    head = "ID LineType AttachA AttachB UnstrLen NumSegs LineOutputs"
    yield from section("LINES", head, "(#) (name) (ID) (ID) (m) (-) (-)", lines)
    head = "ID Point Lines FailTime FailTen"
    yield from section("FAILURE", head, "(#) (#) (,) (s) (N)", _failures(scene, parts, words))


def _points(scene: Scene) -> Iterator[tuple[str, str]]:
    """Name and row of each point, except those of buoys."""
    moved = moved_points(scene)
    numbers = body_numbers(scene)
    attached: dict[str, np.ndarray] = {}
    for body in scene.bodies:
        attached |= body.attachments
    on_buoys = {buoy.point for buoy in scene.buoys}
    for point in scene.points:
        if point.carrier in numbers:
            kind = f"Body{numbers[point.carrier]}"
        elif point.is_free:
            kind = "Free"
        elif point.name in moved:
            kind = "Coupled"
        else:
            kind = "Fixed"
        body = [float(x or 0.0) for x in (point.mass, point.volume, point.drag_area, point.added_mass)]
        if point.name not in on_buoys:
            yield point.name, words_of(kind, *attached.get(point.name, point.position), *body)


def _joints(scene: Scene, parts: list[Stretch]) -> Iterator[tuple[str, str]]:
    """Name and row of each free point between stretches of a line, on the straight line between its ends."""
    taken = set(names_of(scene.points))
    for part, after in pairwise(parts):
        if part.line is not after.line:
            continue
        line = part.line
        if part.end in taken:
            raise SceneError(
                f"point {part.end!r}: this name is needed for a joint of line {line.name!r}. Use another name"
            )
        start = scene.point(line.start).position
        along = scene.point(line.end).position - start
        share = np.sum(line.length[: after.first]) / np.sum(line.length)
        yield part.end, words_of("Free", *(start + share * along), 0.0, 0.0, 0.0, 0.0)


def _failures(scene: Scene, parts: list[Stretch], words: dict[str, str]) -> list[str]:
    """Lines that detach from a point at a time or a tension."""
    lines = by_name(scene.lines)
    rows = []
    for failure in scene.failures:
        position = detachment(parts, failure)
        if position is None:
            continue
        load = failure.load or 0.0
        if failure.load is None and failure.time is None:
            load = lines[failure.line].breaking_load[failure.link - 1]
        number, point = position
        rows.append(words_of(len(rows) + 1, words[point], number, float(failure.time or 0.0), float(load)))
    return rows


def _options(scene: Scene, path: Path, dt: float | None, more: Values) -> Iterator[str]:
    run = scene.run
    sea = scene.sea
    bed = scene.effects.get("seabed")
    values: Table = {"dtM": run.step, "dtOut": run.interval, "g": scene.gravity, "rho": 0.0}
    if dt is not None:
        values["dtM"] = dt
    # a depth [m] that nothing reaches, for a scene without seabed
    reach = sum(line.total for line in scene.lines) + max(np.max(np.abs(p.position)) for p in scene.points)
    values["WtrDpth"] = 10.0 * reach
    if bed is not None:
        values |= {"kBot": bed["stiffness"], "cBot": bed["damping"]}
        if bed["depth"] is not None:
            values["WtrDpth"] = bed["depth"]
        if seafloor := _seafloor_file(scene, path):
            values["SeafloorFile"] = seafloor
    if "seabed_friction" in scene.effects:
        friction = scene.effects["seabed_friction"]
        values |= {"FrictionCoefficient": friction["kinetic"], "FricDamp": friction["damping"]}
        if friction["static"] is not None and friction["kinetic"] > 0.0:
            values["StatDynFricScale"] = short(friction["static"] / friction["kinetic"])
    if sea is not None:
        values |= {"rho": sea.density, "WtrDpth": sea.depth}
        if sea.waves is not None:
            values["WaveKin"] = 7
            if sea.ramp is not None:
                values["waveKin_rampT"] = sea.ramp
        if sea.current is not None:
            values["Currents"] = 1
    if scene.start.kind == "points":
        values["TmaxIC"] = 0
    yield rule("OPTIONS")
    for key, value in {**values, **more}.items():
        if not isinstance(value, int | str):
            value = float(value)
        yield words_of(value, key)


def _outputs(lines: int) -> Iterator[str]:
    yield rule("OUTPUTS")
    for i in range(1, lines + 1):
        yield from (f"FairTen{i}", f"AnchTen{i}")
    yield rule("need this line")


def _table_file(path: Path, name: str) -> str:
    return f"{path.stem}-{name}-axial.txt"


def _seafloor_file(scene: Scene, path: Path) -> str | None:
    """Name of the file of depths; None for a seabed of one depth."""
    if scene.effects.get("seabed", {}).get("bed_x") is None:
        return None
    return f"{path.stem}-seafloor.txt"


def _files(scene: Scene, parts: list[Stretch], path: Path) -> Iterator[tuple[str, str]]:
    """Name and text of each accompanying file."""
    for (_, table), name in name_line_types(part.kind for part in parts).items():
        if table is not None:
            head = [f"--- axial law of {name} ---", "Strain Tension", "(-) (N)"]
            yield _table_file(path, name), _rows_text(head, table).rstrip()  # MoorDyn rejects an empty last line
    sea = scene.sea
    if sea is not None and sea.waves is not None:
        amplitude, omega, phase, direction = np.broadcast_arrays(*wave_components(sea.waves, sea.depth, sea.gravity))
        turn = 0.5 * np.pi - phase
        table = np.stack([omega, amplitude * np.cos(turn), amplitude * np.sin(turn), direction], axis=1)
        yield FREQUENCIES, _rows_text(["0.0 0.0 0.0 0.0"], table)
    if sea is not None and sea.current is not None:
        yield CURRENT, _current_text(sea.current, sea.depth)
    if seafloor := _seafloor_file(scene, path):
        bed = scene.effects["seabed"]
        x = bed["bed_x"]
        y = bed["bed_y"]
        table = np.stack([np.repeat(x, len(y)), np.tile(y, len(x)), -bed["bed_depth"]], axis=1)
        yield seafloor, _rows_text([f"{len(x)} {len(y)}", words_of(*x), words_of(*y)], table)


def _rows_text(head: list[str], rows: Iterable[Sequence[float]]) -> str:
    return "\n".join([*head, *(words_of(*row) for row in rows)]) + "\n"


def _current_text(spec: CurrentSpec, depth: float) -> str:
    """Text of the current file: a table unchanged, or a formula at heights that become dense towards the seabed."""
    heights = spec.heights
    if heights is None:
        heights = depth * (np.linspace(0.0, 1.0, 61) ** 2 - 1.0)
    velocities = np.asarray(make_current(spec).profile(heights, depth), float)
    head = ["----- MoorDyn steady currents file -----", "z ux uy uz", "(m) (m/s) (m/s) (m/s)"]
    return _rows_text(head, np.column_stack([heights, velocities]))
