"""Result tables in MoorDyn's form: `Time` and named channels, with a row of units."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.decks.reading.joints import Part
from dropper_jax.decks.reading.points import read_ends
from dropper_jax.decks.reading.reader import line_parts
from dropper_jax.decks.reading.sections import Deck, looks_like_moordyn, split_file
from dropper_jax.run.line_weights import end_forces
from dropper_jax.run.simulate import Solution
from dropper_jax.scene import LineSlice
from dropper_jax.scene.data import point_nodes

_END = re.compile(r"^(?P<end>FAIR|ANCH)TEN(?P<line>\d+)$")
_LINE = re.compile(r"^L(?:INE)?(?P<line>\d+)N(?P<node>\d+|A|B)(?P<what>P[XYZ]|V[XYZ]|T|TEN)$")
_LINE_END = re.compile(r"^L(?:INE)?(?P<line>\d+)TEN(?P<end>[AB])$")
_POINT = re.compile(r"^(?:POINT|CON|P)(?P<point>\d+)(?P<what>P[XYZ]|V[XYZ])$")
ALLOWED = "FairTen1, AnchTen1, Line1TenA, L1N3T, L1N3px, L1N3vx, Point2px, Con2vz"


def channels_of(path: str | Path) -> list[str]:
    """Channels requested by the OUTPUTS section of a MoorDyn input; none for another kind of file or no file."""
    deck = _deck_of(Path(path))
    if deck is None:
        words = []
    else:
        words = [word for row in deck.rows.get("outputs", []) for word in row.words]
    return [part for word in words for part in word.replace(",", " ").replace('"', " ").split()]


def _deck_of(path: Path) -> Deck | None:
    """The sections of a MoorDyn input; None for another kind of file or no file."""
    if path.is_file():
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    else:
        text = ""
    if looks_like_moordyn(text):
        return split_file(path, text)
    return None


class Numbers(NamedTuple):
    """Numbers by which channels refer to points and lines, and their names.

    `parts` are those of lines of the scene that several lines of a deck make up, by the names of these.
    """

    points: Mapping[int, str]
    lines: Mapping[int, str]
    parts: Mapping[str, Part]

    @classmethod
    def of_scene(cls, solution: Solution) -> Numbers:
        """From 1 in the order of the scene."""
        points = {i + 1: point.name for i, point in enumerate(solution.scene.points)}
        return cls(points, {i + 1: line.name for i, line in enumerate(solution.lines)}, {})


def numbers_of(path: str | Path) -> Numbers | None:
    """The IDs of a MoorDyn input's points and lines; None for another file."""
    deck = _deck_of(Path(path))
    if deck is None:
        return None
    points = {int(key): name for key, name in read_ends(deck, []).names.items() if key.isdecimal()}
    lines = {int(row.words[0]): row.name or f"line-{row.words[0]}" for row in deck.require("lines")}
    return Numbers(points, lines, line_parts(deck))


def default_channels(solution: Solution) -> list[str]:
    """Tension at both ends of every line, and the position of every free point."""
    found = [f"{end}Ten{i + 1}" for i in range(len(solution.lines)) for end in ("Fair", "Anch")]
    points = [i + 1 for i, point in enumerate(solution.scene.points) if point.is_free]
    return found + [f"Point{i}p{axis}" for i in points for axis in "xyz"]


def write_out(
    solution: Solution,
    path: str | Path,
    channels: Sequence[str] | None = None,
    skip: bool = False,
    numbers: Numbers | None = None,
) -> list[str]:
    """Write a table of a run in MoorDyn's form: times [s], names, units, and one row per saved time.

    Lines and points have the IDs of the MoorDyn input if there is one (`numbers`), otherwise they count from 1 in the
    scene's order. As in MoorDyn, the tension [N] at an end is the magnitude of the force on the end node: the tension
    of the link there and half its weight, less its buoyancy in the water. Its drag and inertia, which are small in
    comparison, are neglected.
    At an inner node it is the magnitude of the mean of both links' tension vectors. Tensions belong to
    `solution.t_tension`, half a step before the row's time in midpoint schemes.

    Args:
        channels: channels to write; default: tensions at all ends, positions of free points.
        skip: omit channels that a run does not have, instead of raising an error.
        numbers: from `numbers_of`, of the file from which the scene was read.

    Returns:
        The omitted channels.

    Raises:
        SceneError: a channel that a run does not have.
    """
    if channels is None:
        channels = default_channels(solution)
    else:
        channels = list(channels)
    columns = [("Time", solution.t, "(s)")]
    left = []
    for channel in channels:
        try:
            columns.append((channel, *channel_values(solution, channel, numbers)))
        except SceneError:
            if not skip:
                raise
            left.append(channel)
    names, values, units = zip(*columns, strict=True)
    rows = [names, units, *([f"{float(x):.9g}" for x in row] for row in zip(*values, strict=True))]
    atomic_write(path, "\n".join("\t".join(row) for row in rows) + "\n")
    return left


def channel_values(solution: Solution, channel: str, numbers: Numbers | None = None) -> tuple[np.ndarray, str]:
    """Values (k,) of a channel over the saved times, and their unit."""
    name = channel.upper()
    numbers = numbers or Numbers.of_scene(solution)
    if found := _END.match(name):
        return _end_tension(solution, *_line(solution, channel, found["line"], numbers), found["end"] == "FAIR"), "(N)"
    if found := _LINE_END.match(name):
        return _end_tension(solution, *_line(solution, channel, found["line"], numbers), found["end"] == "B"), "(N)"
    if found := _LINE.match(name):
        return _node(solution, channel, *_line(solution, channel, found["line"], numbers), found["node"], found["what"])
    if found := _POINT.match(name):
        name = _name_of_number(channel, "points", found["point"], numbers.points)
        return _axis(solution, point_nodes(solution.scene)[name], found["what"])
    raise _refuse(channel, "is not available from a run")


def _refuse(channel: str, reason: str) -> SceneError:
    return SceneError(f"output {channel!r}: {reason}; allowed: {ALLOWED}")


def _name_of_number(channel: str, what: str, number: str, names: Mapping[int, str]) -> str:
    if int(number) not in names:
        raise _refuse(channel, f"there are the {what} {', '.join(map(str, names))}")
    return names[int(number)]


def _line(solution: Solution, channel: str, number: str, numbers: Numbers) -> tuple[LineSlice, bool]:
    """The nodes and links of a line by its number, and whether its end A is its last node there."""
    name = _name_of_number(channel, "lines", number, numbers.lines)
    part = numbers.parts.get(name)
    for line in solution.lines:
        if part is not None and line.name == part.line:
            node = line.nodes.start + part.first
            link = line.links.start + part.first
            own = LineSlice(name, slice(node, node + part.links + 1), slice(link, link + part.links))
            return own, part.turned
        if line.name == name:
            return line, False
    raise _refuse(channel, f"line {name!r} is not in the run")


def _end_tension(solution: Solution, line: LineSlice, turned: bool, last: bool) -> np.ndarray:
    forces = end_forces(solution.scene, solution.positions, solution.tension, [line], solution.t)
    return forces[line.name][:, int(last != turned)]


def _axis(solution: Solution, node: int, what: str) -> tuple[np.ndarray, str]:
    if what[0] == "P":
        array = solution.positions
        unit = "(m)"
    else:
        array = solution.velocities
        unit = "(m/s)"
    return array[:, node, "XYZ".index(what[1])], unit


def _node(
    solution: Solution, channel: str, where: LineSlice, turned: bool, text: str, what: str
) -> tuple[np.ndarray, str]:
    links = where.links.stop - where.links.start
    node = {"A": 0, "B": links}.get(text, int(text) if text.isdecimal() else 0)
    if node > links:
        raise _refuse(channel, f"line {where.name!r} has the nodes 0 to {links}")
    node = links - node if turned else node
    if what[0] != "T":
        return _axis(solution, where.nodes.start + node, what)
    if node in (0, links):
        return _end_tension(solution, where, False, node == links), "(N)"
    positions = solution.positions[:, where.nodes.start + node - 1 : where.nodes.start + node + 2]
    along = np.diff(positions, axis=1)
    along = along / np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-300)
    pulls = solution.tension[:, where.links.start + node - 1 : where.links.start + node + 1, None] * along
    return np.linalg.norm(np.mean(pulls, axis=1), axis=1), "(N)"
