"""Quality checks of a pose at rest: strains, breaking loads, bends and sunken buoys."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import first_names
from dropper_jax.base.numerics import unit_vectors
from dropper_jax.load.scene import Scene
from dropper_jax.load.surface import Surface
from dropper_jax.plausibility.line_weights import MOST_NAMES
from dropper_jax.plausibility.plausibility import fastest_current, with_cause
from dropper_jax.plausibility.plausible_points import seabed_under
from dropper_jax.scene import WholeLine, sliced_lines, whole_lines
from dropper_jax.scene.slices import link_differences, point_nodes

#: Static strain of a line above which it is warned of, and above which a scene is an error: a rope breaks before.
STRETCHED = 0.1
TORN = 0.5
#: Fraction of a line's maximum tension above which a link carries tension.
CARRYING = 0.01
#: A buoy whose base is within this distance [m] of the seabed is on it.
NEAR_BED = 0.05


def pose_remarks(scene: Scene, positions: np.ndarray, tension: np.ndarray) -> tuple[str, ...]:
    """Warnings of lines above their breaking load, stretched by 10 % or of too few links, and of sunken buoys.

    Args:
        positions: all nodes (n + 1, 3) [m]; tension: (n,) [N].
    """
    return (
        *_check_loads(scene, tension),
        *_check_stretch(scene, positions),
        *_check_bends(scene, positions, tension),
        *_check_buoys(scene, positions),
    )


def check_stretch(scene: Scene, positions: np.ndarray) -> None:
    """Reject lines that break at rest.

    Raises:
        SceneError: a strain of 50 % or more.
    """
    for line, strain in _strains(scene, positions).items():
        if strain >= TORN:
            flow = ""
            if speed := fastest_current(scene):
                flow = f", and the current of {speed:.4g} m/s"
            error = SceneError(
                f"line {line!r}: is stretched by {strain:.0%} at rest, more than {TORN:.0%}. Check its length "
                f"and EA and the positions of its ends{flow}"
            )
            raise with_cause(error, scene)


def _strains(scene: Scene, positions: np.ndarray) -> dict[str, float]:
    """Maximum strain of a link of each elastic line."""
    links = link_differences(scene, np.asarray(positions)[None])[0]
    strain = np.linalg.norm(links, axis=1) / scene.line.length - 1.0
    return {line.name: float(np.max(strain[where.links])) for line, where in sliced_lines(scene) if not line.rigid}


def _check_stretch(scene: Scene, positions: np.ndarray) -> Iterator[str]:
    """One warning of all lines that are stretched by more than 10 %, with the largest strain."""
    strains = _strains(scene, positions)
    names = sorted((name for name in strains if strains[name] > STRETCHED), key=lambda name: -strains[name])
    if names:
        worst = f"is stretched by {strains[names[0]]:.0%} at rest"
        yield f"{first_names(names, MOST_NAMES)}: {worst}; check its length and EA"


def _check_bends(scene: Scene, positions: np.ndarray, tension: np.ndarray) -> Iterator[str]:
    """One warning of all elastic lines whose links are too few for the forces at their ends."""
    bends = {}
    for line in whole_lines(scene):
        bend = _largest_bend(line, positions[line.nodes], tension[line.links])
        if not line.spec.rigid and bend >= _allowed_bend(line.spec.links):
            bends[line.name] = bend
    if bends:
        worst = max(bends.values())
        yield (
            f"{first_names(list(bends), MOST_NAMES)}: too few links: neighbouring links turn by up to {worst:.0f} "
            "degrees at rest, and end forces can be off by more than 5%. Take four times the links; see --errors"
        )


def _allowed_bend(links: int) -> float:
    """Angle [degrees] between neighbouring links with which the end forces of a line are off by about 5 %.

    A sag of N links has a tension that is off by 1/(2 N^2). Loads on a sharp bend add to it, less so with more links:
    the limit follows 340 single lines of 3 to 12 links against 32 and 48.
    """
    if links <= 3:
        return 5.0
    return 12.0 * (links + 2)


def _largest_bend(line: WholeLine, positions: np.ndarray, tension: np.ndarray) -> float:
    """Maximum angle [degrees] between neighbouring links that carry tension, without attached points."""
    along = unit_vectors(np.diff(positions, axis=0))
    turns = np.degrees(np.arccos(np.clip(np.sum(along[1:] * along[:-1], axis=1), -1.0, 1.0)))
    turns[[node - 1 for node in line.stops if 0 < node < line.spec.links]] = 0.0
    carries = np.maximum(tension[1:], tension[:-1]) > CARRYING * np.max(tension)
    return float(np.max(turns * carries, initial=0.0))


def _check_loads(scene: Scene, tension: np.ndarray) -> Iterator[str]:
    """One warning of all lines above their breaking load, with the one that is most above it."""
    above = {}
    for line, where in sliced_lines(scene):
        if line.breaking_load is not None:
            load = tension[where.links]
            worst = int(np.argmax(load / line.breaking_load))
            above[line.name] = load[worst], line.breaking_load[worst]
    names = [name for name, (load, limit) in above.items() if load > limit]
    if names:
        names.sort(key=lambda name: -above[name][0] / above[name][1])
        load, limit = above[names[0]]
        yield f"{first_names(names, MOST_NAMES)}: {load:.4g} N at rest, above its breaking load of {limit:.4g} N"


def _check_buoys(scene: Scene, positions: np.ndarray) -> Iterator[str]:
    """Warnings of buoys that are under water or on the seabed."""
    if not scene.buoys:
        return
    nodes = point_nodes(scene)
    at = positions[[nodes[buoy.point] for buoy in scene.buoys]]
    level = Surface(scene, waves=False).over(at[None], np.zeros(1))[0]
    bed = seabed_under(scene, at)
    for i, buoy in enumerate(scene.buoys):
        base = float(at[i, 2]) - buoy.attachment
        above = base + buoy.height - float(level[i])
        if above < 0.0:
            yield f"{buoy.name}: at rest its top is {-above:.3g} m under water"
        if base < bed[i] + NEAR_BED:
            yield f"{buoy.name}: at rest its base is on the seabed"
