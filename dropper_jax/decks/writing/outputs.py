"""Result tables in MoorDyn's form: `Time` and named channels, with a row of units."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.base.records import names_of
from dropper_jax.decks.reading.joints import Part
from dropper_jax.decks.reading.points import read_ends
from dropper_jax.decks.reading.reader import line_parts
from dropper_jax.decks.reading.sections import Deck, looks_like_moordyn, split_file
from dropper_jax.quantities.end_forces import end_forces
from dropper_jax.run.simulate import Solution
from dropper_jax.scene import LineSlice
from dropper_jax.scene.slices import point_nodes

#: Other names of the tensions at ends A and B of a line.
ALIASES = ((r"^ANCHTEN(\d+)$", r"L\1NAT"), (r"^FAIRTEN(\d+)$", r"L\1NBT"), (r"^L(?:INE)?(\d+)TEN([AB])$", r"L\1N\2T"))
_LINE = re.compile(r"^L(?:INE)?(?P<line>\d+)N(?P<node>\d+|A|B)(?P<what>P[XYZ]|V[XYZ]|T|TEN)$")
_POINT = re.compile(r"^(?:POINT|CON|P)(?P<point>\d+)(?P<what>P[XYZ]|V[XYZ])$")
ALLOWED = "FairTen1, AnchTen1, Line1TenA, L1N3T, L1N3px, L1N3vx, Point2px, Con2vz"


def channels_of(path: str | Path) -> list[str]:
    """Channels requested by the OUTPUTS section of a MoorDyn input; none for another kind of file or no file."""
    deck = _deck_of(Path(path))
    if deck is None:
        return []
    found = []
    for row in deck.rows["outputs"]:
        found += re.findall(r'[^,"\s]+', " ".join(row.words))
    return found


def _deck_of(path: Path) -> Deck | None:
    """The sections of a MoorDyn input; None for another kind of file or no file."""
    if path.is_file():
        text = path.read_text(encoding="utf-8-sig", errors="replace")
        if looks_like_moordyn(text):
            return split_file(path, text)
    return None


class Numbers(NamedTuple):
    """Numbers by which channels refer to points and lines, and their names; `parts` are where lines of these names are
    in the lines of the scene."""

    points: Mapping[int, str]
    lines: Mapping[int, str]
    parts: Mapping[str, Part]

    @classmethod
    def of_scene(cls, solution: Solution) -> Numbers:
        """From 1 in the order of the scene."""
        points = enumerate(names_of(solution.scene.points), start=1)
        lines = enumerate(names_of(solution.scene.lines), start=1)
        parts = {line.name: Part(line.name, 0, line.links, False) for line in solution.scene.lines}
        return cls(dict(points), dict(lines), parts)


def numbers_of(path: str | Path) -> Numbers | None:
    """The IDs of a MoorDyn input's points and lines; None for another file."""
    deck = _deck_of(Path(path))
    if deck is None:
        return None
    points = {int(key): name for key, name in read_ends(deck).names.items() if key.isdecimal()}
    lines = {int(row.words[0]): row.name("line") for row in deck.require("lines")}
    return Numbers(points, lines, line_parts(deck))


def default_channels(solution: Solution) -> list[str]:
    """Tension at both ends of every line, and the position of every free point."""
    found = []
    for i in range(1, len(solution.lines) + 1):
        found += [f"FairTen{i}", f"AnchTen{i}"]
    for i, point in enumerate(solution.scene.points, start=1):
        if point.is_free:
            found += [f"Point{i}px", f"Point{i}py", f"Point{i}pz"]
    return found


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
    names = ["Time"]
    units = ["(s)"]
    columns = [solution.t]
    left = []
    for channel in channels:
        try:
            values, unit = channel_values(solution, channel, numbers)
        except SceneError:
            if not skip:
                raise
            left.append(channel)
            continue
        names.append(channel)
        units.append(unit)
        columns.append(values)
    head = "\t".join(names) + "\n" + "\t".join(units)
    table = np.stack(columns, axis=1)
    atomic_write(path, lambda file: np.savetxt(file, table, "%.9g", "\t", header=head, comments="", encoding="utf-8"))
    return left


def channel_values(solution: Solution, channel: str, numbers: Numbers | None = None) -> tuple[np.ndarray, str]:
    """Values (k,) of a channel over the saved times, and their unit."""
    name = channel.upper()
    numbers = numbers or Numbers.of_scene(solution)
    for other, own in ALIASES:
        name = re.sub(other, own, name)
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
    part = numbers.parts[name]
    for line in solution.lines:
        if line.name == part.line:
            node = line.nodes.start + part.first
            link = line.links.start + part.first
            return LineSlice(name, slice(node, node + part.links + 1), slice(link, link + part.links)), part.turned
    raise _refuse(channel, f"line {name!r} is not in the run")


def _axis(solution: Solution, node: int, what: str) -> tuple[np.ndarray, str]:
    axis = "XYZ".index(what[1])
    if what[0] == "P":
        return solution.positions[:, node, axis], "(m)"
    return solution.velocities[:, node, axis], "(m/s)"


def _node(
    solution: Solution, channel: str, where: LineSlice, turned: bool, text: str, what: str
) -> tuple[np.ndarray, str]:
    links = where.links.stop - where.links.start
    node = {"A": 0, "B": links}.get(text)
    if node is None:
        node = int(text)
    if node > links:
        raise _refuse(channel, f"line {where.name!r} has the nodes 0 to {links}")
    if turned:
        node = links - node
    if what[0] != "T":
        return _axis(solution, where.nodes.start + node, what)
    if node in (0, links):
        forces = end_forces(solution.scene, solution.positions, solution.tension, [where], solution.t)
        return forces[where.name][:, int(node == links)], "(N)"
    first = where.nodes.start + node - 1
    along = np.diff(solution.positions[:, first : first + 3], axis=1)
    along = along / np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-300)
    first = where.links.start + node - 1
    pulls = solution.tension[:, first : first + 2, None] * along
    return np.linalg.norm(np.mean(pulls, axis=1), axis=1), "(N)"
