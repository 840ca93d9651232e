"""What a line at rest does: forces, length on the bed, stiffness and damping, next to the closed form of a catenary."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.axial import STRETCHING_LAWS
from dropper_jax.base.errors import SceneError
from dropper_jax.explain.catenary import Hanging, Shape, hanging_length, offset_until_uplift, solve
from dropper_jax.load.surface import bed_height

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.scene.line import LineSpec
    from dropper_jax.scene.slices import WholeLine

#: Distance from the bed [m], per metre of a link, within which a node rests on it.
ON_BED = 0.05


@dataclass(frozen=True)
class LineFacts:
    """A line at rest.

    Attributes:
        name: of the line.
        length_m, apart_m: its unstretched length, and the distance of its ends.
        on_bed_m: its length on the seabed.
        uplift_deg: angle of its lower end link above the horizontal.
        lower_n, upper_n: force on its lower and its upper end point.
        closed_lower_n, closed_upper_n: the same by the elastic catenary; None where that does not apply.
        reserve_m: distance by which the upper end may move away before the lower end is lifted off the bed.
        excess_m: length beyond that from which the line hangs straight down from its upper end; negative below it.
        axial_n_per_m: EA over the length.
        horizontal_n_per_m: stiffness of the upper end along the line's plane, by the closed form.
        axial_period_s: period of its first axial mode, both ends held.
        damping_ratio, link_damping_ratio: of that mode, in which links stretch as under one tension, and of the
            stiffest link, by the internal damping.
    """

    name: str
    length_m: float
    apart_m: float
    on_bed_m: float
    uplift_deg: float
    lower_n: float
    upper_n: float
    closed_lower_n: float | None
    closed_upper_n: float | None
    reserve_m: float | None
    excess_m: float | None
    axial_n_per_m: float
    horizontal_n_per_m: float | None
    axial_period_s: float
    damping_ratio: float
    link_damping_ratio: float

    @property
    def verdict(self) -> str:
        """Whether the line is long enough, in words."""
        if self.on_bed_m == self.length_m:
            return "rests on the bed"
        if self.on_bed_m > 0.0 and self.excess_m is not None and self.excess_m > 0.0:
            return f"too long by {self.excess_m:.3g} m: hangs straight down, holds nothing sideways"
        if self.reserve_m is not None and self.reserve_m > 0.0:
            return f"long enough: its anchor lifts after {self.reserve_m:.3g} m of offset"
        if self.reserve_m is not None:
            return f"lifts its anchor by {self.uplift_deg:.3g} degrees"
        if self.on_bed_m > 0.0:
            return "long enough: part of it rests on the bed"
        if self.length_m > self.apart_m:
            return "hangs between its ends"
        return "taut"


def refuse_rigid(scene: Scene) -> None:
    """Refuse a scene with rigid links, whose tensions do not follow from lengths."""
    for line in scene.lines:
        stiffness_of(line)


def stiffness_of(line: LineSpec) -> np.ndarray:
    """EA (n,) [N] of a line that stretches."""
    if line.EA is None:
        raise SceneError(f"line {line.name}: rigid links have no stiffness; allowed for explain: {STRETCHING_LAWS}")
    return line.EA


def line_facts(
    scene: Scene, line: WholeLine, nodes: np.ndarray, weight: float, forces: np.ndarray, angles: np.ndarray
) -> tuple[LineFacts, Shape | None]:
    """The facts of a line, and its closed form where that applies.

    Args:
        nodes: its nodes (n + 1, 3) [m]; weight: in water [N].
        forces, angles: (2,) [N] on its points, and (2,) [deg] of its end links.
    """
    spec = line.spec
    order = [0, -1]  # the lower end first
    if nodes[0, 2] > nodes[-1, 2]:
        order = [-1, 0]
    low, high = nodes[order]
    lower, upper = forces[order]
    length = spec.length.sum()
    on_bed = _length_on_bed(scene, line, nodes)
    closed, shape = _closed_form(_hanging(scene, line, low, high, weight / length, on_bed), weight)
    EA = stiffness_of(spec)
    flexibilities = spec.length / EA
    flexibility = flexibilities.sum()
    rate = np.pi / np.sqrt(flexibility * spec.mass.sum())
    link_rates = 2.0 / np.sqrt(flexibilities * spec.mass)
    stiffest = np.argmax(link_rates)
    decay_times = np.zeros(spec.links)
    if spec.axial_damping is not None:
        decay_times = spec.axial_damping / EA
    facts = LineFacts(
        name=line.name,
        length_m=length,
        apart_m=float(np.linalg.norm(high - low)),
        on_bed_m=on_bed,
        uplift_deg=angles[order[0]],
        lower_n=lower,
        upper_n=upper,
        axial_n_per_m=1.0 / flexibility,
        axial_period_s=2.0 * np.pi / rate,
        damping_ratio=0.5 * rate * np.sum(decay_times * flexibilities) / flexibility,
        link_damping_ratio=0.5 * link_rates[stiffest] * decay_times[stiffest],
        **closed,
    )
    return facts, shape


def _closed_form(hanging: Hanging | None, weight: float) -> tuple[dict[str, float | None], Shape | None]:
    """The fields of `LineFacts` that follow from the closed form of a line of this weight in water [N], None where it
    does not apply, and its forces."""
    found = dict.fromkeys(("closed_lower_n", "closed_upper_n", "reserve_m", "excess_m", "horizontal_n_per_m"))
    if hanging is None:
        return found, None
    found["excess_m"] = hanging.length - hanging.span - hanging_length(hanging)
    if hanging.on_bed:
        found["reserve_m"] = offset_until_uplift(hanging)
    shape = solve(hanging)
    if shape is None:
        return found, None
    ends = [shape.lower, shape.upper]
    if weight < 0.0:  # a line that floats hangs upside down
        ends.reverse()
    found["closed_lower_n"], found["closed_upper_n"] = ends
    if shape.stiffness is not None:
        found["horizontal_n_per_m"] = shape.stiffness[0, 0]
    return found, shape


def _hanging(
    scene: Scene, line: WholeLine, low: np.ndarray, high: np.ndarray, weight: float, on_bed: float
) -> Hanging | None:
    """The line as a uniform one, if it is: no current, no point between its ends, all of it under water, what rests of
    it on a level bed without friction at rest."""
    spec = line.spec
    along_line = [spec.length, spec.mass, stiffness_of(spec), spec.diameter]
    uniform = all(values is not None and np.ptp(values) <= 1e-6 * np.max(values) for values in along_line)
    still = scene.sea is not None and scene.sea.current is None and "bending" not in scene.effects
    simple = len(line.stops) == 2 and weight != 0.0 and spec.axial_law != "tabulated"
    if not (uniform and still and simple) or high[2] > 0.0:
        return None
    if on_bed > 0.0 and not _bed_is_smooth_and_level(scene, np.stack([low, high])):
        return None
    across, along, rise = high - low
    return Hanging(
        span=np.hypot(across, along),
        rise=rise,
        length=spec.length.sum(),
        weight=abs(weight),
        EA=stiffness_of(spec)[0],
        on_bed=weight > 0.0 and on_bed > 0.0,
    )


def _bed_is_smooth_and_level(scene: Scene, ends: np.ndarray) -> bool:
    """Whether the seabed has one height under both ends (2, 3) [m] of a line, and no friction at rest."""
    friction = scene.effects.get("seabed_friction", {"statics": "none"})
    return friction["statics"] == "none" and np.ptp(bed_height(scene, ends)) == 0.0


def _length_on_bed(scene: Scene, line: WholeLine, nodes: np.ndarray) -> float:
    """Unstretched length [m] of the links that rest on the seabed with both nodes."""
    if "seabed" not in scene.effects:
        return 0.0
    length = line.spec.length
    on_bed = nodes[:, 2] - bed_height(scene, nodes) < ON_BED * np.mean(length)
    return np.sum(length[on_bed[1:] & on_bed[:-1]])
