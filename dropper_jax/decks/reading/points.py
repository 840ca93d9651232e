"""Ends of lines of a MoorDyn file, as `[[point]]` and `[[buoy]]` tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dropper_jax.base.markdown import first_names
from dropper_jax.base.read import Table
from dropper_jax.decks.reading.bodies import free_body, free_rod
from dropper_jax.decks.reading.sections import Deck, Row
from dropper_jax.decks.reading.spars import spar

FIXED = ("fixed", "fix", "anchor")
COUPLED = ("coupled", "vessel", "cpld", "ves")
#: Kinds of rods and bodies that rotate about end A or their own position; those that a driver would move stay there.
PINNED_COUPLED = ("coupledpinned", "cpldpin")
PINNED = ("pinned", "pin", *PINNED_COUPLED)
FREE = ("free", "connect", "con", "point", "connection")
BODY = (("mass", "Mass"), ("volume", "Volume"), ("drag_area", "CdA"), ("added_mass", "Ca"))
#: Column names of version 1, whose points also have steady forces between volume and drag area.
FORCES = ["fx", "fy", "fz"]


@dataclass
class Ends:
    """Ends of lines: the points of the scene, its buoys and bodies, and the names of the points by word, in capitals.

    Points on bodies are their attachments, and are not in `points`. `leaving` gives, by the name of its point, the
    direction of a line with bending stiffness at each end of a fixed rod. `turning` contains the points on rods that
    move, `joints` those of free rods without length, which have no mass. `used` are the words of the ends of lines, in
    capitals. Until the scene is complete each table has the line of the file under `row`.
    """

    used: set[str]
    points: list[Table] = field(default_factory=list)
    buoys: list[Table] = field(default_factory=list)
    bodies: list[Table] = field(default_factory=list)
    names: dict[str, str] = field(default_factory=dict)
    leaving: dict[str, list[float]] = field(default_factory=dict)
    turning: list[str] = field(default_factory=list)
    joints: list[str] = field(default_factory=list)

    def add_point(self, row: Row, name: str, position: list[float], **values: str | float) -> None:
        """Add a point that a row of the file gives."""
        self.points.append({"name": name, "row": row.number, "position": position, **values})


def read_ends(deck: Deck) -> Ends:
    """Points, and rods and bodies at which lines end."""
    start, end, *_ = line_columns(deck)
    found = Ends(used=set())
    for row in deck.rows["lines"]:
        row.need(6, "line")
        found.used |= {row.words[start].upper(), row.words[end].upper()}
    for section, what in (("points", "point"), ("rods", "rod"), ("bodies", "body")):
        for row in deck.rows[section]:
            row.need(3, what)  # the words by which rows refer to each other; each reader needs more
    bodies = {row.words[0]: row for row in deck.rows["bodies"]}
    moving = [key for key, row in bodies.items() if _is_rigid_body(row) and _carries_a_line(row, found)]
    for key in moving:
        _add_free_body(bodies[key], found)
    taken = {*moving}
    for row in deck.rows["points"]:
        taken.add(_add_point(row, bodies, found))
    for row in deck.rows["rods"]:
        if _body_number(row) in moving:
            continue
        if found.used.intersection(_end_words(row)):
            taken.add(_add_rod(row, bodies, found))
        else:
            row.note(f"rod {row.words[0]} is not represented: no line ends on it")
    for key, row in bodies.items():
        if key not in taken:
            row.note(f"body {key} is not represented: nothing of the scene is on it")
    return found


def wet_floats_note(floats: Sequence[str]) -> str:
    """What differs for points whose volume lifts them, by name."""
    names = first_names(list(map(repr, floats)), 3)
    return f"points that float ({names}): MoorDyn treats their full volume as submerged, also above the surface"


def line_columns(deck: Deck) -> tuple[int, int, int, int]:
    """Columns of the ends A and B, the length and the number of segments of a line; in version 1 the ends are last."""
    names = deck.columns("lines")
    if len(names) > 2 and names[2].startswith(("unstr", "len")):
        return 4, 5, 2, 3
    return 2, 3, 4, 5


def _body_number(row: Row) -> str:
    """Number of the body that a rod is attached to; empty for others."""
    if row.words[2].lower().startswith("body"):
        return row.words[2][4:]
    return ""


def _end_words(rod: Row) -> tuple[str, str]:
    """The words by which lines end at the ends A and B of a rod."""
    return f"R{rod.words[0]}A", f"R{rod.words[0]}B"


def _rods_on(body: Row) -> list[Row]:
    return [row for row in body.deck.rows["rods"] if _body_number(row) == body.words[0]]


def _points_on(body: Row) -> list[Row]:
    return [row for row in body.deck.rows["points"] if row.words[1].lower() == f"body{body.words[0]}"]


def _carries_a_line(body: Row, found: Ends) -> bool:
    """Whether a line ends on a body."""
    words = {row.words[0].upper() for row in _points_on(body)}
    for row in _rods_on(body):
        words.update(_end_words(row))
    return bool(words & found.used)


def _is_rigid_body(body: Row) -> bool:
    """Whether a body rotates: a pinned one, or a free one other than a spar buoy (see `spar`)."""
    kind = body.words[1].lower()
    if kind != "free":
        return kind in PINNED
    rods = _rods_on(body)
    return len(rods) != 1 or spar(body, rods[0]) is None


def _add_free_body(row: Row, found: Ends) -> None:
    """A body with its rods, and the points on it at which lines end."""
    on = _rods_on(row)
    rods = [rod for rod in on if not _is_connector(rod)]
    body = free_body(row, rods)
    attached = {}
    for point in _points_on(row):
        if point.words[0].upper() in found.used:
            point.need(5, "point")
            attached[point.name("point")] = point.values(2, 5, "X, Y, Z")
    for rod, shape in zip(rods, body.get("cylinders", []), strict=True):
        attached |= _add_rod_ends(rod, shape["from"], shape["to"], found)
    for rod in on:
        if _is_connector(rod):
            position = rod.values(3, 6, "Xa, Ya, Za")
            attached |= _add_rod_ends(rod, position, position, found)
    _add_body(row, f"body {row.words[0]}", row.words[1].lower(), body | {"attachments": attached}, found)


def _add_body(row: Row, what: str, kind: str, body: Table, found: Ends) -> None:
    """Add the `[[body]]` of a body or rod of this kind."""
    if kind in PINNED:
        body["pinned"] = True
    if kind in PINNED_COUPLED:
        row.note(f"{what} is coupled and pinned: it is pinned at its position")
    found.bodies.append(body)


def _is_connector(row: Row) -> bool:
    """Whether a rod has a direction but neither length nor mass: `NumSegs 0`."""
    row.need(10, "rod")
    return not row.integer(9, "NumSegs", 0)


def _add_rod_ends(rod: Row, start: list[float], end: list[float], found: Ends) -> dict[str, list[float]]:
    """Positions in a body's axes of the ends of a rod at which lines end, by name of the point."""
    attached = {}
    for word, position in zip(_end_words(rod), (start, end), strict=True):
        if word in found.used:
            name = f"point-{word}"
            found.names[word] = name
            found.turning.append(name)
            attached[name] = position
    return attached


def _add_point(row: Row, bodies: dict[str, Row], found: Ends) -> str:
    """A point of the scene; returns the body to which it is attached, or an empty text."""
    row.need(5, "point")
    key = row.words[0]
    kind = row.words[1].lower()
    if key.upper() in found.names:
        row.refuse(f"point {key} is given twice")
    name = row.name("point")
    found.names[key.upper()] = name
    position = row.values(2, 5, "X, Y, Z")
    holder = kind.removeprefix("body")
    body = None
    if holder != kind:
        body = bodies.get(holder)
    if body is not None:
        if not _is_rigid_body(body):
            found.add_point(row, name, _position_on_fixed_body(row, body, position))
        return holder
    if kind in FREE:
        found.add_point(row, name, position, kind="free", **_point_body(row))
        return ""
    if kind in COUPLED:
        row.note(f"point {key} is coupled: it is fixed at its position; use effects.end_motion to move it")
    elif kind.startswith(("body", "turbine")):
        row.refuse(f"point {key} on {row.words[1]!r}: is not in the file; allowed: Fixed, Coupled, Free")
    elif kind not in FIXED:
        row.refuse(f"point {key}: {row.words[1]!r} is unknown; allowed: Fixed, Coupled, Free")
    found.add_point(row, name, position)
    return ""


def _position_on_fixed_body(row: Row, body: Row, position: list[float]) -> list[float]:
    """Position of a point on a coupled or fixed body: the body's own position plus the point's offset."""
    body.need(8, "body")
    kind = body.words[1].lower()
    if kind not in (*COUPLED, *FIXED):
        row.refuse(
            f"point {row.words[0]} on body {body.words[0]}, {body.words[1]!r}: is not supported; allowed: free, "
            "pinned, coupled or fixed bodies; of a spar buoy (moment of inertia 1e10 kg m^2 or more) its rod's end A",
        )
    turned = body.values(5, 8, "r0, p0, y0")
    if any(turned):
        body.refuse(
            f"body {body.words[0]} is rotated by {turned}; allowed: 0, with rotated positions of its points",
        )
    if kind in COUPLED:
        row.note(
            f"point {row.words[0]} is on coupled body {body.words[0]}: it is fixed at its position; "
            "use [[vessel]] to move such points together"
        )
    return np.add(body.values(2, 5, "X0, Y0, Z0"), position).tolist()


def _point_body(row: Row) -> dict[str, float]:
    """Mass, volume, drag area and added mass of a free point, if it has any."""
    words = list(row.words[5:])
    if row.deck.columns("points")[7:10] == FORCES:
        forces = [row.read(word, "FX, FY, FZ") for word in words[2:5]]
        if any(forces):
            row.note(f"forces {forces} on point {row.words[0]} are not represented")
        del words[2:5]
    found = {}
    for (key, label), word in zip(BODY, words, strict=False):
        if value := row.read(word, label, 0.0):
            found[key] = value
    return found


def _add_rod(row: Row, bodies: dict[str, Row], found: Ends) -> str:
    """A free rod, a joint, a fixed rod, or a spar buoy and its point; returns its body, or an empty text."""
    holder = row.words[2].lower()
    if holder == "free" and _is_connector(row):
        _add_joint(row, found)
    elif holder in ("free", *PINNED):
        body = free_rod(row)
        shape = body["cylinders"][0]
        body["attachments"] = _add_rod_ends(row, shape["from"], shape["to"], found)
        _add_body(row, f"rod {row.words[0]}", holder, body, found)
    elif holder in (*COUPLED, *FIXED):
        _add_fixed_rod(row, found)
    else:
        _add_spar(row, bodies.get(_body_number(row)), found)
        return _body_number(row)
    return ""


def _add_joint(row: Row, found: Ends) -> None:
    """A free rod without length: a free point."""
    name = row.given_name or f"point-R{row.words[0]}"
    found.add_point(row, name, row.values(3, 6, "Xa, Ya, Za"), kind="free")
    found.names.update(dict.fromkeys(found.used.intersection(_end_words(row)), name))
    found.joints.append(name)


def _add_fixed_rod(row: Row, found: Ends) -> None:
    """The ends of a fixed or coupled rod as fixed points."""
    row.need(10, "rod")
    key = row.words[0]
    start = row.values(3, 6, "Xa to Zb")
    end = row.values(6, 9, "Xa to Zb")
    along = np.subtract(end, start)
    if _is_connector(row):
        end = start
    for word, position, direction in zip(_end_words(row), (start, end), (-along, along), strict=True):
        if word in found.used:
            name = f"point-{word}"
            found.names[word] = name
            found.add_point(row, name, position)
            found.leaving[name] = direction.tolist()
    if _is_connector(row):
        row.note(f"rod {key} has no length; a line with EI is clamped along it (MoorDyn 2.7.2 lets it turn)")
    if row.words[2].lower() in COUPLED:
        row.note(f"rod {key} is coupled: its ends are fixed; use [[vessel]] to move such points together")


def _add_spar(row: Row, body: Row | None, found: Ends) -> None:
    """A spar buoy and its point, at end A of its rod."""
    word, other_word = _end_words(row)
    buoy = None
    if body is not None:
        buoy = spar(body, row)
    if body is None or buoy is None or other_word in found.used:
        row.refuse(
            f"rod {row.words[0]}, {row.words[2]!r}: is not represented; allowed: free, pinned, coupled and fixed rods, "
            "rods on free or pinned bodies, and upright ones without mass on a free body that cannot turn, lines at "
            "their end A",
        )
    name = body.given_name or f"point-{word}"
    found.add_point(body, name, body.values(2, 5, "X0, Y0, Z0"), kind="free")
    found.buoys.append({**buoy, "point": name})
    found.names[word] = name
