"""Wakes against measurements: a cylinder's far wake, and the farm of Plew et al. (2005) over what is not stated of it.

Cylinder: Browne, Antonia and Shah (1987), case 3 of the ERCOFTAC database (its readme: d = 2.67 mm, U = 6.7 m/s,
U d/nu = 1190, half-width of the velocity defect 12.3 mm at x/d = 420); its drag coefficient is taken as 1.0.

Farm (IEEE J. Oceanic Eng., abstract): 230 longlines in 20 blocks, 650 m by 2450 m, loops 8 m deep and, fully laden,
0.20 m or more wide, water of 10 to 12 m; the current within it was reduced by 36 to 63 %, and flowed beneath it nearly
twice as fast as within. Not stated there, and assumed here: blocks 2 by 10, 11.5 longlines of 200 m each, 20 m
apart, current along the longer side and across the longlines, C_D 1.3, turbulence 5 %; swept: ropes per metre of
longline, of which there are two for every loop.

    python benchmarks/farm_wakes.py
"""

from dataclasses import dataclass

import numpy as np
from study import Found, collect, command

from dropper_jax.run.wakes import Elements, solve_wakes

#: Farm: extents along and across the current [m], blocks along and across, pitch of longlines [m].
LONG, WIDE, ALONG, ACROSS, PITCH = 2450.0, 650.0, 10, 2, 20.0
#: Length of a longline [m], depth of loops, width of ropes, depth of the water [m], C_D, current [m/s].
BACKBONE, LOOPS, ROPE, DEPTH, DRAG, SPEED = 200.0, 8.0, 0.2, 11.0, 1.3, 0.1
#: Width of a piece of longline that is one element [m].
PIECE = 50.0
ROPES, TURBULENCE = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0), 0.05


@dataclass(frozen=True)
class Fence(Elements):
    """Pieces of longlines: what `Elements` are, of many ropes side by side."""

    ropes: float = 1.0

    @property
    def area(self) -> np.ndarray:
        return self.ropes * self.wide * self.diameter * self.high


def farm(ropes: float) -> Fence:
    """The farm's longlines in pieces, with so many ropes per metre."""
    block = LONG / ALONG
    rows = [i * block + PITCH * j for i in range(ALONG) for j in range(11 + i % 2)]  # 11.5 on average
    pieces = np.arange(-BACKBONE / 2 + PIECE / 2, BACKBONE / 2, PIECE)
    across = np.concatenate([side * WIDE / (2 * ACROSS) + pieces for side in (-1.0, 1.0)])
    x, y = (a.ravel() for a in np.meshgrid(rows, across, indexing="ij"))
    equal = (np.full(len(x), value) for value in (-LOOPS / 2, PIECE, LOOPS, ROPE, DRAG))
    return Fence(x, y, *equal, ropes)


def row(ropes: float, depth: float = DEPTH, turbulence: float = TURBULENCE) -> Found:
    """The farm's reduction of the current, and Plew's."""
    elements = farm(ropes)
    wakes = solve_wakes(elements, SPEED, depth, turbulence)
    lost = 1.0 - wakes.met / SPEED
    inside = elements.x > elements.x.min()
    beneath = [
        float(wakes.plane(x).deficit(np.array([0.25 * WIDE]), np.array([0.5 * (-LOOPS - depth)]))[0, 0])
        for x in np.linspace(0.2, 0.9, 8) * LONG
    ]
    return {
        "ropes_per_m": ropes,
        "depth_m": depth,
        "turbulence": turbulence,
        "crop_rope_km": ropes * BACKBONE * LOOPS * 230 / 1000.0,
        "reduction_mean": float(lost[inside].mean()),
        "reduction_max": float(lost.max()),
        "reduction_beneath": float(np.mean(beneath) / SPEED),
        "balance": wakes.balance,
        "plew_2011": plew_2011(ropes, depth),
    }


def plew_2011(ropes: float, depth: float, mixing: float = 0.04, bed: float = 0.0025) -> float:
    """Reduction within an endless suspended canopy by Plew (2011, J. Hydraul. Eng. 137), steady over the depth.

    As the R package `macrogrow` (stormeyseas/macrogrow, `u_c`) writes it, with its constants `mixing` (a2) and `bed`
    (Cb). The longlines' density is that of a whole farm: 230 longlines over 650 m by 2450 m.
    """
    frontal = DRAG * ropes * BACKBONE * 230 * ROPE / (WIDE * LONG)  # C_D a [1/m]
    drag, height = 0.5 * depth * frontal, LOOPS / depth
    inner = drag * (1 - height) * height * (bed * height + mixing) - mixing * bed * height
    if inner <= 0.0:
        return 0.0
    above = -mixing - bed * height**2 + (1 - height) * np.sqrt(inner)
    return float(1.0 - above / (drag * height * (1 - height) ** 3 - mixing - bed * height**3))


def cylinder() -> Found:
    """Half-width and defect behind one cylinder against the measured half-width and its momentum."""
    d, speed, away, measured = 2.67e-3, 6.7, 420.0, 12.3e-3
    high = 1.0  # so long that its ends do not matter
    wire = Elements(*(np.array([value]) for value in (0.0, 0.0, -high / 2, 0.0, high, d, 1.0)))
    plane = solve_wakes(wire, speed, high, 0.0).plane(away * d)
    y = np.linspace(0.0, 0.1, 20001)
    nodes, weight = np.polynomial.legendre.leggauss(20)
    defect = plane.deficit(y, 0.5 * high * (nodes - 1.0)) @ (0.5 * weight)  # its mean over the length
    half = float(np.interp(-0.5 * defect[0], -defect, y))
    # a Gaussian as wide as measured, with the momentum of C_D = 1
    wanted = 0.5 * d / (measured * np.sqrt(np.pi / np.log(2.0)))
    return {
        "half_width_over_d": {"measured": measured / d, "ours": half / d},
        "defect_over_u": {"from_measured_width": float(wanted), "ours": float(defect[0] / speed)},
    }


@command()
def main():
    parts = {
        "rows": map(row, ROPES),
        "others": (row(2.0, *given) for given in ((10.0, TURBULENCE), (12.0, TURBULENCE), (DEPTH, 0.1))),
    }
    collect("farm_wakes", parts, schema=1, cylinder=cylinder())
