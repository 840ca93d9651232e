"""Result tables in MoorDyn's form: `Time` and named channels, with a row of units."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.moordyn.reading.sections import looks_like_moordyn, split_file
from dropper_jax.run.solution import LineSlice, Solution
from dropper_jax.scene.nodes import point_nodes

_END = re.compile(r"^(?P<end>FAIR|ANCH)TEN(?P<line>\d+)$")
_LINE = re.compile(r"^L(?:INE)?(?P<line>\d+)N(?P<node>\d+|A|B)(?P<what>P[XYZ]|V[XYZ]|T|TEN)$")
_LINE_END = re.compile(r"^L(?:INE)?(?P<line>\d+)TEN(?P<end>[AB])$")
_POINT = re.compile(r"^(?:POINT|CON|P)(?P<point>\d+)(?P<what>P[XYZ]|V[XYZ])$")
ALLOWED = "FairTen1, AnchTen1, Line1TenA, L1N3T, L1N3px, L1N3vx, Point2px, Con2vz"


def channels_of(path: str | Path) -> list[str]:
    """Channels that the OUTPUTS section of a MoorDyn input asks for; none where it is another file or no file."""
    path = Path(path)
    if not path.is_file():
        return []
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    if not looks_like_moordyn(text):
        return []
    deck = split_file(path, text)
    words = [word for row in deck.rows.get("outputs", []) for word in row.words]
    return [part for word in words for part in word.replace(",", " ").replace('"', " ").split()]


def default_channels(solution: Solution) -> list[str]:
    """Tension at both ends of every line, and the place of every free point."""
    found = [f"{end}Ten{i + 1}" for i in range(len(solution.lines)) for end in ("Fair", "Anch")]
    points = [i + 1 for i, point in enumerate(solution.scene.points) if point.kind == "free"]
    return found + [f"Point{i}p{axis}" for i in points for axis in "xyz"]


def write_out(
    solution: Solution, path: str | Path, channels: Sequence[str] | None = None, skip: bool = False
) -> list[str]:
    """Write a MoorDyn-like table of a run: times [s], names, units, and one row per saved time.

    Lines and points count from 1 in the order of the scene. Tensions [N] are MoorDyn's: at an end that of the link
    there, at an inner node the size of the mean of both links' pulls; they belong to `solution.t_tension`, half a step
    before the row's time in midpoint schemes.

    Args:
        channels: what to write; default: tensions at all ends, places of free points.
        skip: leave out channels that a run does not have, instead of refusing them.

    Returns:
        The channels left out.

    Raises:
        SceneError: a channel that a run does not have.
    """
    channels = default_channels(solution) if channels is None else list(channels)
    columns, units, names, left = [], [], [], []
    for channel in channels:
        try:
            values, unit = channel_values(solution, channel)
        except SceneError:
            if not skip:
                raise
            left.append(channel)
            continue
        names.append(channel)
        units.append(unit)
        columns.append(values)
    rows = ["\t".join(["Time", *names]), "\t".join(["(s)", *units])]
    for row in zip(solution.t, *columns, strict=True):
        rows.append("\t".join(f"{float(x):.9g}" for x in row))
    atomic_write(path, "\n".join(rows) + "\n")
    return left


def channel_values(solution: Solution, channel: str) -> tuple[np.ndarray, str]:
    """Values (k,) of a channel over the saved times, and their unit."""
    name = channel.upper()
    if found := _END.match(name):
        return _end_tension(solution, channel, int(found["line"]), found["end"] == "FAIR"), "(N)"
    if found := _LINE_END.match(name):
        return _end_tension(solution, channel, int(found["line"]), found["end"] == "B"), "(N)"
    if found := _LINE.match(name):
        return _node(solution, channel, int(found["line"]), found["node"], found["what"])
    if found := _POINT.match(name):
        number = int(found["point"])
        if not 1 <= number <= len(solution.scene.points):
            raise _refuse(channel, f"the scene has {len(solution.scene.points)} points")
        node = point_nodes(solution.scene)[solution.scene.points[number - 1].name]
        return _axis(solution, node, found["what"])
    raise _refuse(channel, "is not among what a run has")


def _refuse(channel: str, reason: str) -> SceneError:
    return SceneError(f"output {channel!r}: {reason}; allowed: {ALLOWED}")


def _line(solution: Solution, channel: str, number: int) -> LineSlice:
    if not 1 <= number <= len(solution.lines):
        raise _refuse(channel, f"the scene has {len(solution.lines)} lines")
    return solution.lines[number - 1]


def _end_tension(solution: Solution, channel: str, number: int, last: bool) -> np.ndarray:
    where = _line(solution, channel, number).links
    return solution.tension[:, where.stop - 1 if last else where.start]


def _axis(solution: Solution, node: int, what: str) -> tuple[np.ndarray, str]:
    array, unit = (solution.positions, "(m)") if what[0] == "P" else (solution.velocities, "(m/s)")
    return array[:, node, "XYZ".index(what[1])], unit


def _node(solution: Solution, channel: str, number: int, text: str, what: str) -> tuple[np.ndarray, str]:
    where = _line(solution, channel, number)
    links = where.links.stop - where.links.start
    node = {"A": 0, "B": links}.get(text, int(text) if text.isdecimal() else 0)
    if node > links:
        raise _refuse(channel, f"line {number} has the nodes 0 to {links}")
    if what[0] != "T":
        return _axis(solution, where.nodes.start + node, what)
    if node in (0, links):
        return _end_tension(solution, channel, number, node == links), "(N)"
    places = solution.positions[:, where.nodes.start + node - 1 : where.nodes.start + node + 2]
    along = np.diff(places, axis=1)
    along = along / np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-300)
    pulls = solution.tension[:, where.links.start + node - 1 : where.links.start + node + 1, None] * along
    return np.linalg.norm(np.mean(pulls, axis=1), axis=1), "(N)"
