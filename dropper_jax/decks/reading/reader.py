"""From a MoorDyn input file to the plain values of a scene."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

from dropper_jax.base.errors import LocatedValues, SceneError, nearest
from dropper_jax.base.files import find_referenced
from dropper_jax.base.read import Plain, Table
from dropper_jax.base.toml_text import parsed_toml
from dropper_jax.decks.reading.joints import DeckLine, Part, join_lines
from dropper_jax.decks.reading.options import Options, read_options, read_seafloor, read_types
from dropper_jax.decks.reading.points import Ends, first_version, read_ends, wet_floats_note
from dropper_jax.decks.reading.sections import Deck, read_input, split_file
from dropper_jax.decks.reading.water import read_current, read_waves

#: Values used if the file does not give them; MoorDyn's driver would.
DEFAULT_STEP = 0.01
DEFAULT_DURATION = 60.0
#: Outputs that belong to a line: tensions at its ends, and values of its nodes.
OUTPUT = re.compile(r"(?:fair|anch)ten(\d+)|l(?:ine)?(\d+)(?:n\d+|[ab])?(?:p|v|t|f|st|sr)\w*", re.IGNORECASE)
#: Options by the scene paths that they set.
OPTION_OF = {
    **{"effects.weight.gravity": "g", "sea.gravity": "g", "sea.density": "rho", "sea.depth": "wtrdpth"},
    **{"effects.seabed": "seafloorfile", "effects.seabed.depth": "wtrdpth", "effects.seabed.stiffness": "kbot"},
    **{"effects.seabed.damping": "cbot", "effects.seabed_friction.kinetic": "frictioncoefficient"},
    **{"effects.seabed_friction.static": "statdynfricscale", "sea.waves": "wavekin", "sea.ramp": "wavekin_rampt"},
    **{"sea.current": "currents", "run.dt": "dtm", "run.save_every": "dtout", "start": "tmaxic"},
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
    notes = [*options.missed]
    types = read_types(deck, notes)
    ends = read_ends(deck, notes)
    own_lines = _lines(deck, types, ends.names)
    _check_outputs(deck)
    held = {point["name"] for point in ends.points if point.get("kind") != "free"}
    if not ends.bodies and all(line.links == 1 and {line.start, line.end} <= held for line in own_lines):
        for line in own_lines:  # MoorDyn's only stretch; here at least one node must be free
            line.links = 2
            notes.append(f"line {line.name!r}: NumSegs 1 between fixed points: 2 links are used")
    used = {line.type for line in own_lines}
    bending = _bending(own_lines, types, ends, notes)
    broken = _failures(deck, own_lines, ends.names, notes)
    lines, parts = join_lines(own_lines, ends.joints)
    for failure in broken:
        failure |= _link_of(parts[failure["line"]], failure["link"])
    notes += _joint_notes(lines, parts, options.values["tmaxic"] == 0.0)
    at_ends = {line[key] for line in lines for key in ("from", "to")}
    inside = {name for name in ends.joints if name not in at_ends}
    left = [point["name"] for point in ends.points if point["name"] not in {*at_ends, *inside}]
    notes += [f"point {name!r} is not represented: no line ends there" for name in left]
    scene: Table = {
        "name": path.stem,
        "description": "",
        "run": _run(options, notes),
        "line_type": [types[name] for name in types if name in used],
        "point": [point for point in ends.points if point["name"] in at_ends],
        "line": lines,
        "buoy": ends.buoys,
        "body": ends.bodies,
        "effects": _effects(options, path.parent, bending),
        "failure": broken,
        **_sea(deck, options, notes),
    }
    scene = {key: value for key, value in scene.items() if value or key not in ("buoy", "body", "failure")}
    if options.values["tmaxic"] == 0.0:
        scene["start"] = {"kind": "points"}
    density = options.values["rho"]
    floats = [p["name"] for p in scene["point"] if density * p.get("volume", 0.0) > p.get("mass", 0.0)]
    if floats:
        notes.append(wet_floats_note(floats))
    without = [section for section in WITHOUT if deck.rows.get(section)]
    notes += [f"line {deck.first[section]}: section {section.upper()} is not represented" for section in without]
    if options.left:
        notes.append(f"options without a counterpart: {', '.join(options.left)}")
    _apply_free_text(deck, scene)
    if "duration" not in scene["run"]:
        scene["run"]["duration"] = max(DEFAULT_DURATION, scene["run"]["dt"])
        notes.append(f"the file has no duration: {scene['run']['duration']:g} s are used")
    all_notes = [f"{path.name}: {note}" for note in notes]
    earlier = scene.get("notes")  # of the source file of the scene
    if isinstance(earlier, list):
        all_notes = earlier + all_notes
    numbers = _lines_of(deck, scene, ends, options)
    if all_notes:
        scene["notes"] = all_notes
    return LocatedValues(scene, str(path), numbers)


def _lines_of(deck: Deck, scene: Table, ends: Ends, options: Options) -> dict[str, int]:
    """The line number in the file of each item of the scene, by path."""
    found = {key: deck.noted[key] for key in deck.given}
    found |= {key: options.lines[name] for key, name in OPTION_OF.items() if name in options.lines}
    of = {row.words[0]: row.number for row in deck.rows.get("line types", [])}
    found |= {f"line_type.{i}": of[kind["name"]] for i, kind in enumerate(scene["line_type"])}
    rows = {row.name or f"line-{row.words[0]}": row.number for row in deck.rows["lines"]}
    found |= {f"line.{i}": rows[line["name"]] for i, line in enumerate(scene["line"]) if line["name"] in rows}
    at: dict[str, int] = {}
    for section, kinds, suffixes in (("points", (), ("",)), ("bodies", ("body",), ()), ("rods", ("rod", "buoy"), "AB")):
        for row in deck.rows.get(section, []):
            words = [f"R{row.words[0]}{end}" if section == "rods" else row.words[0] for end in suffixes]
            own = [ends.names[word] for word in words if word in ends.names]
            for name in (*own, row.name, *(f"{kind}-{row.words[0]}" for kind in kinds)):
                at.setdefault(name, row.number)
    for key in ("point", "buoy", "body"):
        found |= {f"{key}.{i}": at[item["name"]] for i, item in enumerate(scene.get(key, [])) if item["name"] in at}
    return found | ({"failure": deck.first["failure"]} if "failure" in deck.first else {})


def _check_depth(deck: Deck, options: Options, depth: float) -> None:
    """Use the caller's depth if the file has none."""
    if not 0.0 < depth < math.inf:
        raise SceneError(f"--depth: {depth:g} is out of range; allowed: > 0 m")
    if options.values["wtrdpth"] or "seafloorfile" in options.texts:
        at = options.lines.get("wtrdpth", options.lines.get("seafloorfile", 1))
        deck.refuse(at, f"--depth: {depth:g} m, but the file gives its own. Remove --depth")
    options.values["wtrdpth"] = depth


def _lines(deck: Deck, types: Table, names: dict[str, str]) -> list[DeckLine]:
    found: dict[str, DeckLine] = {}
    by_upper = {key.upper(): name for key, name in names.items()}
    order = (4, 5, 2, 3) if first_version(deck) else (2, 3, 4, 5)
    for row in deck.require("lines"):
        row.need(6, "line")
        start, end = (row.words[i] for i in order[:2])
        if row.words[0] in found:
            row.refuse(f"line {row.words[0]} is given twice")
        if row.words[1] not in types:
            row.refuse(f"line type {row.words[1]!r} is not in the file; {nearest(row.words[1], types)}")
        for end_word in (start, end):
            if end_word.upper() not in by_upper:
                row.refuse(f"{end_word!r} is not a point of the file; {nearest(end_word, names)}")
        if start.upper() == end.upper():
            row.refuse(f"line {row.words[0]} starts and ends at {start}; allowed: two different points")
        found[row.words[0]] = DeckLine(
            name=row.name or f"line-{row.words[0]}",
            start=by_upper[start.upper()],
            end=by_upper[end.upper()],
            type=row.words[1],
            length=row.value(order[2], "UnstrLen", 0.0, open_low=True),
            links=row.integer(order[3], "NumSegs"),
        )
    return list(found.values())


def line_parts(deck: Deck) -> dict[str, Part]:
    """Where each line of a deck is in the lines of its scene, by its name."""
    ends = read_ends(deck, [])
    return join_lines(_lines(deck, read_types(deck, []), ends.names), ends.joints)[1]


def _joint_notes(lines: list[Table], parts: dict[str, Part], as_given: bool) -> list[str]:
    """A note for each line that is joined of several, whose start may be `as_given` by the positions of points."""
    joined = [line["name"] for line in lines if "sections" in line]
    own = {}
    for name in joined:
        own[name] = [key for key, part in parts.items() if part.line == name]
    if as_given:
        start = "; it starts straight, without the rods' positions"
    else:
        start = ""
    found = []
    for name, keys in own.items():
        found.append(
            f"lines {', '.join(keys)}, joined by rods without mass and length, are the sections of line {name!r}{start}"
        )
    return found


def _link_of(part: Part, link: int) -> Table:
    """Line and link of the scene of a line's link, from 1."""
    own = part.links + 1 - link if part.turned else link
    return {"line": part.line, "link": part.first + own}


def _check_outputs(deck: Deck) -> None:
    """Reject an output of a line that is not in the file."""
    known = [row.words[0] for row in deck.rows.get("lines", [])]
    for row in deck.rows.get("outputs", []):
        for word in row.words:
            found = OUTPUT.fullmatch(word.strip(',"'))
            if found and (found[1] or found[2]) not in known:
                row.refuse(f"output {word!r}: there is no such line; allowed: {', '.join(known)}")


def _failures(deck: Deck, lines: list[DeckLine], names: dict[str, str], notes: list[str]) -> list[Table]:
    """`[[failure]]` entries: the first or last link of each line that detaches from a point."""
    found: list[Table] = []
    by_upper = {key.upper(): name for key, name in names.items()}
    by_number = {row.words[0]: line for row, line in zip(deck.rows["lines"], lines, strict=True)}
    for row in deck.rows.get("failure", []):
        row.need(5, "failure")
        point = by_upper.get(row.words[1].upper(), "")
        time = row.value(3, "FailTime", 0.0)
        load = row.value(4, "FailTen", 0.0)
        given = {key: value for key, value in (("time", time), ("load", load)) if value > 0.0}
        for word in row.words[2].split(","):
            line = by_number.get(word)
            if line is None or point not in (line.start, line.end):
                row.refuse(f"line {word} does not end at point {row.words[1]}")
            if given:
                link = 1
                if line.start != point:
                    link = line.links
                found.append({"line": line.name, "link": link, **given})
        if load > 0.0 and "," in row.words[2]:
            notes.append(f"line {row.number}: the lines of a failure detach one by one, each at its own tension")
    return found


def _run(options: Options, notes: list[str]) -> Table:
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
    every = max(1, round(options.values["dtout"] / dt))
    if every > 1:
        return {"dt": dt, "save_every": every}
    return {"dt": dt}


def _bending(lines: list[DeckLine], types: Table, ends: Ends, notes: list[str]) -> Table | None:
    """`[effects.bending]` of lines with EI, clamped where they end at fixed rods (as in MoorDyn); None without any."""
    stiff = [line for line in lines if "EI" in types[line.type]]
    if not stiff:
        return None
    every = [name for line in lines for name in (line.start, line.end)]
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


def _effects(options: Options, folder: Path, bending: Table | None) -> Table:
    values = options.values
    bed: Table = {"stiffness": values["kbot"], "damping": values["cbot"]}
    if "seafloorfile" in options.texts:
        bed.update(read_seafloor(_seafloor(options, folder)))
    elif not values["rho"]:
        bed["depth"] = values["wtrdpth"]
    found: Table = {"weight": {"gravity": values["g"]}}
    if values["rho"]:
        found |= {"buoyancy": {}, "morison_drag": {}, "morison_inertia": {}}
    if values["wtrdpth"] or "bed_x" in bed:
        kinetic = values["frictioncoefficient"]
        friction = {"law": "moordyn", "kinetic": kinetic, "damping": values["fricdamp"]}
        found |= {"seabed": bed} | ({"seabed_friction": friction} if kinetic else {})
        if values["statdynfricscale"] > 1.0:
            friction["static"] = kinetic * values["statdynfricscale"]
    if bending is None:
        return found
    return {**found, "bending": bending}


def _seafloor(options: Options, folder: Path) -> Path:
    """The seabed file: in the input's folder or, as in MoorDyn, relative to the working folder."""
    text = options.texts["seafloorfile"]
    elsewhere = not (folder / text).exists() and Path(text).exists()
    return find_referenced(text, "SeafloorFile", None if elsewhere else folder)


def _sea(deck: Deck, options: Options, notes: list[str]) -> Table:
    """`[sea]`; None if the water has no density."""
    values = options.values
    folder = deck.path.parent
    if not values["rho"]:
        return {}
    depth = values["wtrdpth"]
    if "seafloorfile" in options.texts and not depth:
        depths = read_seafloor(_seafloor(options, folder))["bed_depth"]
        depth = sum(depths) / len(depths)
    if depth <= 0.0:
        at = options.lines.get("wtrdpth", deck.first.get("options", 1))
        deck.refuse(at, "WtrDpth: missing; needed: > 0 m, in the file or as --depth")
    sea: Table = {"depth": depth, "density": values["rho"], "gravity": values["g"]}
    waves = values["wavekin"]
    current = values["currents"]
    if waves in (2.0, 3.0, 7.0):
        sea["waves"] = read_waves(folder, int(waves), values["dtwave"], notes)
        if waves == 2.0:
            notes.append("WaveKin 2: components are summed as listed, not interpolated to even frequencies")
    elif waves:
        notes.append(f"WaveKin {waves:g} is not represented: the water has no waves")
    if values["wavekin_rampt"] and "waves" in sea:
        sea["ramp"] = values["wavekin_rampt"]
        notes.append("waveKin_rampT: MoorDyn's ramp is linear; here it is sin^2 of the same length")
    if current == 1.0:
        sea["current"] = read_current(folder)
    elif current:
        notes.append(f"Currents {current:g} is not represented: the water has no current")
    return {"sea": sea}


def _apply_free_text(deck: Deck, scene: Table) -> None:
    """Names, run settings and lines in several pieces, from the free text."""
    for key, text in deck.given.items():
        try:
            value = parsed_toml(f"value = {text}")["value"]
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
    if isinstance(given, list):
        lists = [names for names in given if isinstance(names, list)]
    else:
        lists = []
    whole = {}
    for names in lists:
        if all(isinstance(name, str) for name in names):
            for name in names[1:]:
                whole[name] = names[0]
    for line in lines:
        if line["name"] in whole:
            line["piece_of"] = whole[line["name"]]
