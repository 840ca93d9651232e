"""What a single line of a scene must agree with."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import refuse
from dropper_jax.load.checks_system import check_ends, check_span
from dropper_jax.scene import LineSpec, PointSpec, point_named


def check_line(line: LineSpec, points: tuple[PointSpec, ...]) -> None:
    check_ends((line,), points)
    start, end = point_named(points, line.start), point_named(points, line.end)
    if start.kind != "fixed":
        names = [point.name for point in points]
        raise refuse(f"point.{names.index(start.name)}.kind", start.kind, "cannot begin a rigid line", "fixed")
    if end.kind == "fixed":
        _check_reach(line, "line.0", start, end)


def _check_reach(line: LineSpec, path: str, start: PointSpec, end: PointSpec) -> None:
    """Links between two held ends must be able to close: no side of the polygon exceeds the sum of the others."""
    if line.links < 2:
        raise refuse(f"{path}.links", line.links, "leaves nothing free between two held ends", "a whole number >= 2")
    if not line.rigid:
        return
    distance = check_span(line, path, start, end)
    longest = float(np.max(line.length))
    others = line.total - longest + distance
    if longest >= others:
        raise SceneError(
            f"{path}.length: a link of {longest:g} m cannot be closed by the others and the {distance:g} m between "
            f"the ends; allowed: less than {others:g} m"
        )
