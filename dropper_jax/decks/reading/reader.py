"""From a MoorDyn input file to the plain values of a scene."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import LocatedValues, SceneError, nearest
from dropper_jax.base.read import Plain, Table
from dropper_jax.base.records import column
from dropper_jax.base.references import find_referenced
from dropper_jax.base.toml_text import parse_toml_text
from dropper_jax.decks.reading.joints import DeckLine, Part, join_lines
from dropper_jax.decks.reading.line_types import read_types
from dropper_jax.decks.reading.options import Options, read_options, read_seafloor
from dropper_jax.decks.reading.points import Ends, line_columns, read_ends, wet_floats_note
from dropper_jax.decks.reading.sections import Deck, read_input, split_file
from dropper_jax.decks.reading.water import read_current, read_waves

#: Values used if the file does not give them; MoorDyn's driver would.
DEFAULT_STEP = 0.01
DEFAULT_DURATION = 60.0
#: Outputs that belong to a line: tensions at its ends, and values of its nodes.
OUTPUT = re.compile(r"(?:fair|anch)ten(\d+)|l(?:ine)?(\d+)(?:n\d+|[ab])?(?:p|v|t|f|st|sr)\w*", re.IGNORECASE)
#: Options by the scene paths that they set.
OPTION_OF = {
    "effects.weight.gravity": "g",
    "sea.gravity": "g",
    "sea.density": "rho",
    "sea.depth": "wtrdpth",
    "effects.seabed": "seafloorfile",
    "effects.seabed.depth": "wtrdpth",
    "effects.seabed.stiffness": "kbot",
    "effects.seabed.damping": "cbot",
    "effects.seabed_friction.kinetic": "frictioncoefficient",
    "effects.seabed_friction.static": "statdynfricscale",
    "sea.waves": "wavekin",
    "sea.ramp": "wavekin_rampt",
    "sea.current": "currents",
    "run.dt": "dtm",
    "run.save_every": "dtout",
    "start": "tmaxic",
}
#: Sections without a counterpart in a scene.
WITHOUT = ("control", "external loads", "syrope ic")


def read_moordyn(path: str | Path, depth: float | None = None) -> Table:
    """The plain values of the scene of a MoorDyn input, version 1 or 2; what the scene lacks is listed under `notes`.

    Lines are tension-only ropes of their type. Damping acts on taut links only (MoorDyn also applies it to slack ones).
    Points that move with a vessel are fixed. Wave and current files are expected in the folder of the input, as in
    MoorDyn.

    Args:
        depth: depth of the water [m], if the file has none.

    Raises:
        SceneError: with file and line: an unknown section or option, a value that is not a number, a line whose type or
            points are not in the file.
    """
    path = Path(path)
    deck = split_file(path, read_input(path))
    options = read_options(deck)
    if depth is not None:
        _check_depth(deck, options, depth)
    types = read_types(deck)
    ends = read_ends(deck)
    lines = _read_lines(deck, types, ends)
    _check_outputs(deck)
    bending = _bending_values(lines, types, ends, deck.notes)
    as_given = options.values["tmaxic"] == 0.0
    parts = _line_values(deck, lines, ends, as_given)
    seafloor = _seafloor_values(options, path.parent)
    used = {line.type for line in lines}
    scene: Table = {
        "name": path.stem,
        "description": "",
        "run": _run_values(options, deck.notes),
        "line_type": [kind for name, kind in types.items() if name in used],
        **parts,
        "effects": _effect_values(options, seafloor, bending),
        **_sea_values(deck, options, seafloor),
    }
    if as_given:
        scene["start"] = {"kind": "points"}
    _note_differences(deck, options, scene)
    numbers = _line_numbers(deck, scene, options)
    _apply_free_text(deck, scene)
    if "duration" not in scene["run"]:
        scene["run"]["duration"] = max(DEFAULT_DURATION, scene["run"]["dt"])
        deck.notes.append(f"the file has no duration: {scene['run']['duration']:g} s are used")
    notes = [f"{path.name}: {note}" for note in deck.notes]
    earlier = scene.get("notes")  # of the source file of the scene
    if isinstance(earlier, list):
        notes = earlier + notes
    if notes:
        scene["notes"] = notes
    return LocatedValues(scene, str(path), numbers)


def _line_values(deck: Deck, lines: list[DeckLine], ends: Ends, as_given: bool) -> Table:
    """The lines of the scene, what they end at and where they break; the start may be `as_given` by the points."""
    broken = _read_failures(deck, lines, ends.names)
    joined, parts = join_lines(lines, ends.joints)
    _move_failures(broken, parts)
    deck.notes += _joint_notes(joined, parts, as_given)
    at_ends = {*column(joined, "from"), *column(joined, "to")}
    for point in ends.points:
        if point["name"] not in {*at_ends, *ends.joints}:
            deck.notes.append(f"point {point['name']!r} is not represented: no line ends there")
    found = {
        "point": [point for point in ends.points if point["name"] in at_ends],
        "line": joined,
        "buoy": ends.buoys,
        "body": ends.bodies,
        "failure": broken,
    }
    return {key: value for key, value in found.items() if value or key == "point"}


def _note_differences(deck: Deck, options: Options, scene: Table) -> None:
    """Add notes on floats, on sections and on options that the scene does not represent."""
    density = options.values["rho"]
    floats = [p["name"] for p in scene["point"] if density * p.get("volume", 0.0) > p.get("mass", 0.0)]
    if floats:
        deck.notes.append(wet_floats_note(floats))
    for section in WITHOUT:
        if deck.rows[section]:
            deck.notes.append(f"line {deck.first[section]}: section {section.upper()} is not represented")
    if options.left:
        deck.notes.append(f"options without a counterpart: {', '.join(options.left)}")


def _free_a_node(lines: list[DeckLine], ends: Ends, notes: list[str]) -> None:
    """Divide links between fixed points in two if no node is free: MoorDyn's only stretch."""
    held = {point["name"] for point in ends.points if point.get("kind") != "free"}
    if ends.bodies or not all(line.links == 1 and {line.start, line.end} <= held for line in lines):
        return
    for line in lines:
        line.links = 2
        notes.append(f"line {line.name!r}: NumSegs 1 between fixed points: 2 links are used")


def _move_failures(failures: list[Table], parts: dict[str, Part]) -> None:
    """Give failures of lines of the deck the numbers that their links have in the lines of the scene."""
    for failure in failures:
        part = parts[failure["line"]]
        link = failure["link"]
        if part.turned:
            link = part.links + 1 - link
        failure |= {"line": part.line, "link": part.first + link}


def _line_numbers(deck: Deck, scene: Table, options: Options) -> dict[str, int]:
    """The line number in the file of each item of the scene, by path; removes `row` from the items."""
    found = {**deck.noted}
    found |= {path: options.lines[name] for path, name in OPTION_OF.items() if name in options.lines}
    for key in ("line_type", "line", "point", "buoy", "body"):
        for i, item in enumerate(scene.get(key, [])):
            found[f"{key}.{i}"] = item.pop("row")
    if "failure" in deck.first:
        found["failure"] = deck.first["failure"]
    return found


def _check_depth(deck: Deck, options: Options, depth: float) -> None:
    """Use the caller's depth if the file has none."""
    if not 0.0 < depth < math.inf:
        raise SceneError(f"--depth: {depth:g} is out of range; allowed: > 0 m")
    if options.values["wtrdpth"] or "seafloorfile" in options.texts:
        at = options.lines.get("wtrdpth", options.lines.get("seafloorfile", 1))
        deck.refuse(at, f"--depth: {depth:g} m, but the file gives its own. Remove --depth")
    options.values["wtrdpth"] = depth


def _read_lines(deck: Deck, types: Table, ends: Ends) -> list[DeckLine]:
    """The lines of the deck, with their links in the scene."""
    names = ends.names
    found: dict[str, DeckLine] = {}
    start_column, end_column, length, links = line_columns(deck)
    for row in deck.require("lines"):
        key, kind = row.words[:2]
        start = row.words[start_column]
        end = row.words[end_column]
        if key in found:
            row.refuse(f"line {key} is given twice")
        if kind not in types:
            row.refuse(f"line type {kind!r} is not in the file; {nearest(kind, types)}")
        for word in (start, end):
            if word.upper() not in names:
                row.refuse(f"{word!r} is not a point of the file; {nearest(word, names)}")
        if start.upper() == end.upper():
            row.refuse(f"line {key} starts and ends at {start}; allowed: two different points")
        found[key] = DeckLine(
            name=row.name("line"),
            start=names[start.upper()],
            end=names[end.upper()],
            type=kind,
            length=row.value(length, "UnstrLen", above=0.0),
            links=row.integer(links, "NumSegs"),
            row=row.number,
        )
    lines = list(found.values())
    _free_a_node(lines, ends, deck.notes)
    return lines


def line_parts(deck: Deck) -> dict[str, Part]:
    """Where each line of a deck is in the lines of its scene, by its name."""
    ends = read_ends(deck)
    return join_lines(_read_lines(deck, read_types(deck), ends), ends.joints)[1]


def _joint_notes(lines: list[Table], parts: dict[str, Part], as_given: bool) -> Iterator[str]:
    """A note for each line that is joined of several, whose start may be `as_given` by the positions of points."""
    start = ""
    if as_given:
        start = "; it starts straight, without the rods' positions"
    for line in lines:
        if "sections" in line:
            names = ", ".join(key for key, part in parts.items() if part.line == line["name"])
            yield (
                f"lines {names}, joined by rods without mass and length, are the sections of line "
                f"{line['name']!r}{start}"
            )


def _check_outputs(deck: Deck) -> None:
    """Reject an output of a line that is not in the file."""
    known = [row.words[0] for row in deck.rows["lines"]]
    for row in deck.rows["outputs"]:
        for word in row.words:
            found = OUTPUT.fullmatch(word.strip(',"'))
            if found and (found[1] or found[2]) not in known:
                row.refuse(f"output {word!r}: there is no such line; allowed: {', '.join(known)}")


def _read_failures(deck: Deck, lines: list[DeckLine], names: dict[str, str]) -> list[Table]:
    """`[[failure]]` entries: the first or last link of each line that detaches from a point."""
    found: list[Table] = []
    by_number = {row.words[0]: line for row, line in zip(deck.rows["lines"], lines, strict=True)}
    for row in deck.rows["failure"]:
        row.need(5, "failure")
        point = names.get(row.words[1].upper(), "")
        given = {"time": row.value(3, "FailTime", 0.0), "load": row.value(4, "FailTen", 0.0)}
        given = {key: value for key, value in given.items() if value}
        words = row.words[2].split(",")
        for word in words:
            line = by_number.get(word)
            if line is None or point not in (line.start, line.end):
                row.refuse(f"line {word} does not end at point {row.words[1]}")
            if given:
                link = 1
                if line.start != point:
                    link = line.links
                found.append({"line": line.name, "link": link, **given})
        if "load" in given and len(words) > 1:
            row.note("the lines of a failure detach one by one, each at its own tension")
    return found


def _run_values(options: Options, notes: list[str]) -> Table:
    dt = options.values["dtm"]
    if dt <= 0.0:
        notes.append(f"the file has no time step dtM: {DEFAULT_STEP:g} s is used")
        dt = DEFAULT_STEP
    elif dt < 1e-3:  # needed for the stability of an explicit scheme, not for accuracy
        notes.append(
            f"dtM of {dt:g} s keeps MoorDyn's explicit scheme stable: {DEFAULT_STEP:g} s is used. Use run.dt for "
            "another step"
        )
        dt = DEFAULT_STEP
    run = {"dt": dt}
    every = round(options.values["dtout"] / dt)
    if every > 1:
        run["save_every"] = every
    return run


def _bending_values(lines: list[DeckLine], types: Table, ends: Ends, notes: list[str]) -> Table | None:
    """`[effects.bending]` of lines with EI, clamped where they end at fixed rods (as in MoorDyn); None without any."""
    stiff = [line for line in lines if "EI" in types[line.type]]
    if not stiff:
        return None
    every = [line.start for line in lines] + [line.end for line in lines]
    clamped = []
    for line in stiff:
        for name in (line.start, line.end):
            pinned = f"line {line.name!r} is pinned on {name.removeprefix('point-')}"
            if name in ends.turning:
                notes.append(f"{pinned}, which moves; in MoorDyn it is clamped along the rod")
            elif name in ends.leaving and every.count(name) > 1:
                notes.append(f"{pinned}, where others end; in MoorDyn it is clamped")
            elif name in ends.leaving:
                clamped.append(name)
    if clamped:
        return {"clamped": clamped, "directions": [ends.leaving[name] for name in clamped]}
    return {}


def _effect_values(options: Options, seafloor: Table, bending: Table | None) -> Table:
    values = options.values
    found: Table = {"weight": {"gravity": values["g"]}}
    bed = {"stiffness": values["kbot"], "damping": values["cbot"], **seafloor}
    if values["rho"]:
        found |= {"buoyancy": {}, "morison_drag": {}, "morison_inertia": {}}
    elif not seafloor:
        bed["depth"] = values["wtrdpth"]
    kinetic = values["frictioncoefficient"]
    if values["wtrdpth"] or seafloor:
        found["seabed"] = bed
        if kinetic:
            found["seabed_friction"] = {"law": "moordyn", "kinetic": kinetic, "damping": values["fricdamp"]}
            if values["statdynfricscale"] > 1.0:
                found["seabed_friction"]["static"] = kinetic * values["statdynfricscale"]
    if bending is not None:
        found["bending"] = bending
    return found


def _seafloor_values(options: Options, folder: Path) -> Table:
    """The seabed file: in the input's folder or, as in MoorDyn, relative to the working folder; empty without one."""
    text = options.texts.get("seafloorfile")
    if text is None:
        return {}
    base = folder
    if not (folder / text).exists() and Path(text).exists():
        base = None
    return read_seafloor(find_referenced(text, "SeafloorFile", base))


def _sea_values(deck: Deck, options: Options, seafloor: Table) -> Table:
    """`[sea]`; empty if the water has no density."""
    values = options.values
    folder = deck.path.parent
    if not values["rho"]:
        return {}
    depth = values["wtrdpth"]
    if seafloor and not depth:
        depth = float(np.mean(seafloor["bed_depth"]))
    if depth <= 0.0:
        at = options.lines.get("wtrdpth", deck.first.get("options", 1))
        deck.refuse(at, "WtrDpth: missing; needed: > 0 m, in the file or as --depth")
    sea: Table = {"depth": depth, "density": values["rho"], "gravity": values["g"]}
    waves = values["wavekin"]
    if waves in (2.0, 3.0, 7.0):
        sea["waves"] = read_waves(folder, int(waves), values["dtwave"], deck.notes)
        if waves == 2.0:
            deck.notes.append("WaveKin 2: components are summed as listed, not interpolated to even frequencies")
        if values["wavekin_rampt"]:
            sea["ramp"] = values["wavekin_rampt"]
            deck.notes.append("waveKin_rampT: MoorDyn's ramp is linear; here it is sin^2 of the same length")
    elif waves:
        deck.notes.append(f"WaveKin {waves:g} is not represented: the water has no waves")
    current = values["currents"]
    if current == 1.0:
        sea["current"] = read_current(folder)
    elif current:
        deck.notes.append(f"Currents {current:g} is not represented: the water has no current")
    return {"sea": sea}


def _apply_free_text(deck: Deck, scene: Table) -> None:
    """Names, run settings and lines in several pieces, from the free text."""
    for key, text in deck.given.items():
        try:
            value = parse_toml_text(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            continue  # a remark of the user, not a value written by this package
        match key.split("."):
            case ["pieces"]:
                _join_pieces(scene["line"], value)
            case ["law"]:
                for kind in scene["line_type"]:
                    kind.setdefault("law", value)  # tables have their own
            case ["run", name]:
                scene["run"][name] = value
            case ["name" | "description" | "notes"]:
                scene[key] = value


def _join_pieces(lines: list[Table], given: Plain) -> None:
    """Set the line from which each piece was cut; a list of anything else is a remark of the user."""
    whole = {}
    if not isinstance(given, list):
        return
    for names in given:
        if isinstance(names, list) and all(isinstance(name, str) for name in names):
            whole |= dict.fromkeys(names[1:], names[0])
    for line in lines:
        if line["name"] in whole:
            line["piece_of"] = whole[line["name"]]
