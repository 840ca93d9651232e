"""Ends of lines of a MoorDyn file, as `[[point]]` and `[[buoy]]` tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from dropper_jax.base.markdown import first_names
from dropper_jax.base.read import Table
from dropper_jax.decks.reading.bodies import free_body, free_rod
from dropper_jax.decks.reading.sections import Deck, Row
from dropper_jax.decks.reading.spars import spar

FIXED = ("fixed", "fix", "anchor")
COUPLED = ("coupled", "vessel", "cpld", "ves")
#: Kinds of rods and bodies that rotate about end A or their own position; those that a driver would move stay there.
PINNED = ("pinned", "pin")
PINNED_COUPLED = ("coupledpinned", "cpldpin")
FREE = ("free", "connect", "con", "point", "connection")
BODY = (("mass", "Mass"), ("volume", "Volume"), ("drag_area", "CdA"), ("added_mass", "Ca"))
#: Column names of version 1, whose points also have steady forces between volume and drag area.
FORCES = ("FX", "FY", "FZ")


@dataclass
class Ends:
    """Ends of lines: the points of the scene, its buoys and bodies, and the name of the point for each word of a file.

    Points on bodies are their attachments, and are not in `points`. `leaving` gives, by the name of its point, the
    direction of a line with bending stiffness at each end of a fixed rod. `turning` contains the points on rods that
    move, `joints` those of free rods without length, which have no mass.
    """

    points: list[Table] = field(default_factory=list)
    buoys: list[Table] = field(default_factory=list)
    bodies: list[Table] = field(default_factory=list)
    names: dict[str, str] = field(default_factory=dict)
    leaving: dict[str, list[float]] = field(default_factory=dict)
    turning: list[str] = field(default_factory=list)
    joints: list[str] = field(default_factory=list)


def read_ends(deck: Deck, notes: list[str]) -> Ends:
    """Points, and rods and bodies at which lines end."""
    found = Ends()
    bodies = {row.words[0]: row for row in deck.rows.get("bodies", [])}
    taken = set()
    used = {w.upper() for row in deck.rows.get("lines", []) for w in _ends(deck, row)}
    for key, row in bodies.items():
        if _moves(deck, row) and _carries(deck, row, used):
            _free_body(deck, row, found, used, notes)
            taken.add(key)
    moving = set(taken)
    for row in deck.rows.get("points", []):
        taken |= _point(deck, row, bodies, found, notes)
    for row in deck.rows.get("rods", []):
        word = f"R{row.words[0]}"
        if _holder(row) in moving:
            continue
        if not {f"{word}A", f"{word}B"} & used:
            notes.append(f"line {row.number}: rod {row.words[0]} is not represented: no line ends on it")
            continue
        taken.add(_rod(deck, row, bodies, found, used, notes))
    left = [(key, row.number) for key, row in bodies.items() if key not in taken]
    notes += [f"line {line}: body {key} is not represented: nothing of the scene is on it" for key, line in left]
    return found


def wet_floats_note(floats: Sequence[str]) -> str:
    """What differs for points whose volume lifts them, by name."""
    names = first_names([repr(name) for name in floats], 3)
    return f"points that float ({names}): MoorDyn treats their full volume as submerged, also above the surface"


def _holder(row: Row) -> str:
    """Number of the body that a rod is attached to; empty for others."""
    if row.words[2].lower().startswith("body"):
        return row.words[2][4:]
    return ""


def _on(deck: Deck, body: Row) -> list[Row]:
    return [row for row in deck.rows.get("rods", []) if _holder(row) == body.words[0]]


def _points_on(deck: Deck, body: Row) -> list[Row]:
    return [row for row in deck.rows.get("points", []) if row.words[1].lower() == f"body{body.words[0]}"]


def _carries(deck: Deck, body: Row, used: set[str]) -> bool:
    """Whether a line ends on a body."""
    points = {row.words[0].upper() for row in _points_on(deck, body)}
    return bool((points | {f"R{row.words[0]}{end}".upper() for row in _on(deck, body) for end in "AB"}) & used)


def _moves(deck: Deck, body: Row) -> bool:
    """Whether a body rotates: a pinned one, or a free one other than a spar buoy (see `spar`)."""
    kind = body.words[1].lower()
    rods = _on(deck, body)
    if kind != "free":
        return kind in (*PINNED, *PINNED_COUPLED)
    return not (len(rods) == 1 and spar(deck, body, rods[0], "") is not None)


def _free_body(deck: Deck, row: Row, found: Ends, used: set[str], notes: list[str]) -> None:
    """A body with its rods, and the points on it at which lines end."""
    connectors = [rod for rod in _on(deck, row) if _is_connector(rod)]
    rods = [rod for rod in _on(deck, row) if rod not in connectors]
    body = free_body(deck, row, rods, notes) | _pinned_field(row, row.words[1], f"body {row.words[0]}", notes)
    attached = {}
    for point in _points_on(deck, row):
        if point.words[0].upper() in used:
            point.need(5, "point")
            name = point.name or f"point-{point.words[0]}"
            attached[name] = point.values(2, 5, "X, Y, Z")
    for rod, shape in zip(rods, body.get("cylinders", []), strict=True):
        attached |= _rod_ends(rod, shape, found, used)
    for rod in connectors:
        position = rod.values(3, 6, "Xa, Ya, Za")
        attached |= _rod_ends(rod, {"from": position, "to": position}, found, used)
    if attached:
        body = {**body, "attachments": attached}
    found.bodies.append(body)


def _pinned_field(row: Row, kind: str, what: str, notes: list[str]) -> Table:
    """Additional keys of `[[body]]` for a pinned body or rod."""
    if kind.lower() in PINNED_COUPLED:
        notes.append(f"line {row.number}: {what} is coupled and pinned: it is pinned at its position")
    if kind.lower() in (*PINNED, *PINNED_COUPLED):
        return {"pinned": True}
    return {}


def _is_connector(row: Row) -> bool:
    """Whether a rod has a direction but neither length nor mass: `NumSegs 0`."""
    row.need(10, "rod")
    return not row.integer(9, "NumSegs", 0)


def _rod_ends(rod: Row, shape: Table, found: Ends, used: set[str]) -> dict[str, list[float]]:
    """Positions in a body's axes of the ends of a rod at which lines end, by name of the point."""
    ends = {f"R{rod.words[0]}{end}": shape[key] for end, key in (("A", "from"), ("B", "to"))}
    attached = {word: position for word, position in ends.items() if word in used}
    found.names.update({word: f"point-{word}" for word in attached})
    found.turning.extend(f"point-{word}" for word in attached)
    return {f"point-{word}": position for word, position in attached.items()}


def _ends(deck: Deck, row: Row) -> tuple[str, str]:
    """Words of the two ends of a line; version 1 has them after length and segments."""
    row.need(6, "line")
    first = 4 if first_version(deck) else 2
    return row.words[first], row.words[first + 1]


def first_version(deck: Deck) -> bool:
    """Whether lines have length and segments before their ends, according to the column names."""
    names = [word.lower() for word in deck.columns.get("lines", ())]
    return len(names) > 2 and names[2].startswith(("unstr", "length", "len"))


def _point(deck: Deck, row: Row, bodies: dict[str, Row], found: Ends, notes: list[str]) -> set[str]:
    """A point of the scene; returns the bodies to which it is attached."""
    row.need(5, "point")
    key = row.words[0]
    kind = row.words[1].lower()
    if key in found.names:
        row.refuse(f"point {key} is given twice")
    name = row.name or f"point-{key}"
    position = row.values(2, 5, "X, Y, Z")
    point: Table = {"name": name, "position": position}
    if kind in FREE:
        point |= {"kind": "free", **_body(deck, row, notes)}
    elif kind in COUPLED:
        notes.append(
            f"line {row.number}: point {key} is coupled: it is fixed at its position; use effects.end_motion to move it"
        )
    elif kind.startswith("body") and kind[4:] in bodies and _moves(deck, bodies[kind[4:]]):
        found.names[key] = name
        return {kind[4:]}
    elif kind.startswith("body") and kind[4:] in bodies:
        point["position"] = _on_held(row, bodies[kind[4:]], position, notes)
    elif kind.startswith(("body", "turbine")):
        row.refuse(f"point {key} on {row.words[1]!r}: is not in the file; allowed: Fixed, Coupled, Free")
    elif kind not in FIXED:
        row.refuse(f"point {key}: {row.words[1]!r} is unknown; allowed: Fixed, Coupled, Free")
    found.names[key] = name
    found.points.append(point)
    if kind.startswith("body"):
        return {kind[4:]}
    return set()


def _on_held(row: Row, body: Row, position: list[float], notes: list[str]) -> list[float]:
    """Position of a point on a coupled or fixed body: the body's own position plus the point's offset."""
    body.need(8, "body")
    kind = body.words[1].lower()
    if kind not in (*COUPLED, *FIXED):
        row.refuse(
            f"point {row.words[0]} on body {body.words[0]}, {body.words[1]!r}: is not supported; allowed: free, "
            "pinned, coupled or fixed bodies; of a spar buoy (moment of inertia 1e10 kg m^2 or more) its rod's end A",
        )
    origin = body.values(2, 5, "X0, Y0, Z0")
    turned = body.values(5, 8, "r0, p0, y0")
    if any(turned):
        body.refuse(
            f"body {body.words[0]} is rotated by {turned}; allowed: 0, with rotated positions of its points",
        )
    if kind in COUPLED:
        notes.append(
            f"line {row.number}: point {row.words[0]} is on coupled body {body.words[0]}: it is fixed at its position; "
            "use [[vessel]] to move such points together"
        )
    return [a + b for a, b in zip(origin, position, strict=True)]


def _body(deck: Deck, row: Row, notes: list[str]) -> dict[str, float]:
    """Mass, volume, drag area and added mass of a free point, if it has any."""
    names = [word.upper() for word in deck.columns.get("points", ())]
    words = list(row.words[5:])
    if names[7:10] == list(FORCES):
        forces = [row.read(w, "FX, FY, FZ") for w in words[2:5]]
        if any(forces):
            notes.append(f"line {row.number}: forces {forces} on point {row.words[0]} are not represented")
        words = words[:2] + words[5:]
    values = {key: row.read(w, label, 0.0) for (key, label), w in zip(BODY, words, strict=False)}
    return {key: value for key, value in values.items() if value}


def _rod(deck: Deck, row: Row, bodies: dict[str, Row], found: Ends, used: set[str], notes: list[str]) -> str:
    """A free rod, a joint, a fixed rod, or a spar buoy and its point; returns its body."""
    key = row.words[0]
    holder = row.words[2]
    if holder.lower() == "free" and _is_connector(row):
        joint = row.name or f"point-R{key}"
        position = row.values(3, 6, "Xa, Ya, Za")
        found.points.append({"name": joint, "kind": "free", "position": position})
        found.names.update({word: joint for word in (f"R{key}A", f"R{key}B") if word in used})
        found.joints.append(joint)
        return ""
    if holder.lower() in ("free", *PINNED, *PINNED_COUPLED):
        body = free_rod(deck, row) | _pinned_field(row, holder, f"rod {key}", notes)
        found.bodies.append({**body, "attachments": _rod_ends(row, body["cylinders"][0], found, used)})
        return ""
    if holder.lower() in (*COUPLED, *FIXED):
        row.need(10, "rod")
        a = row.values(3, 6, "Xa to Zb")
        b = row.values(6, 9, "Xa to Zb")
        connector = _is_connector(row)
        for word, position, sign in ((f"R{key}A", a, -1.0), (f"R{key}B", a if connector else b, 1.0)):
            if word in used:
                found.names[word] = f"point-{word}"
                found.points.append({"name": f"point-{word}", "position": position})
                found.leaving[f"point-{word}"] = [sign * (y - x) for x, y in zip(a, b, strict=True)]
        rod = f"line {row.number}: rod {key}"
        if connector:
            notes.append(f"{rod} has no length; a line with EI is clamped along it (MoorDyn 2.7.2 lets it turn)")
        if holder.lower() in COUPLED:
            notes.append(f"{rod} is coupled: its ends are fixed; use [[vessel]] to move such points together")
        return ""
    body = bodies.get(_holder(row))
    buoy = None
    if body is not None:
        buoy = spar(deck, body, row, row.name or f"buoy-{key}")
    if body is None or buoy is None or f"R{key}B" in used:
        row.refuse(
            f"rod {key}, {holder!r}: is not represented; allowed: free, pinned, coupled and fixed rods, rods on free "
            "or pinned bodies, and upright ones without mass on a free body that cannot turn, lines at their end A",
        )
    point = body.name or f"point-R{key}A"
    found.points.append({"name": point, "kind": "free", "position": buoy.pop("position")})
    found.buoys.append({**buoy, "point": point})
    found.names[f"R{key}A"] = point
    return body.words[0]
