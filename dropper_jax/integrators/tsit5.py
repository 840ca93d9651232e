"""Tsitouras' scheme of fifth order with an error estimate of fourth, for smooth, rigid lines.

Coefficients: Tsitouras, Runge-Kutta pairs of order 5(4) satisfying only the first column simplifying assumption,
Computers and Mathematics with Applications 62 (2011).
"""

from __future__ import annotations

from dataclasses import dataclass

from dropper_jax.integrators.projected_runge_kutta import ProjectedRungeKutta


@dataclass(frozen=True)
class Tsit5(ProjectedRungeKutta):
    """Six stages, fifth order. The error estimate also uses the rate at the end of the step."""

    name = "tsit5"
    order = 5
    stable = 3.0
    # stages at 0, 0.161, 0.327, 0.9, 0.98 and 1 of the step
    a = (
        (0.161,),
        (-0.008480655492356989, 0.335480655492357),
        (2.8971530571054935, -6.359448489975075, 4.3622954328695815),
        (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525),
        (5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383),
    )
    b = (
        0.09646076681806523,
        0.01,
        0.4798896504144996,
        1.379008574103742,
        -3.290069515436081,
        2.324710524099774,
    )
    # b minus the weights of the solution of fourth order, in which the rate at the end of the step is the last
    errors = (
        (
            0.0017800110522257773,
            0.0008164344596567463,
            -0.007880878010261994,
            0.1447110071732629,
            -0.5823571654525552,
            0.45808210592918686,
            -0.015151515151515152,
        ),
    )
