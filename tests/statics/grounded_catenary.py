"""The elastic catenary of a line that partly lies on a flat bed, with and without friction (Jonkman 2007, 2.6)."""

import numpy as np
from scipy.optimize import fsolve


def fairlead_forces(length, w, EA, span, rise, friction=0.0):
    """Horizontal and vertical force [N] at the upper end of a line of wet weight w [N/m].

    Args:
        span, rise: horizontal and vertical distance of the ends [m].
        friction: mu of the part on the bed, Jonkman's CB.
    """

    def rows(u):
        h, v = np.exp(u)
        lies = length - v / w
        stretch = h * length / EA
        if friction:
            slack = max(lies - h / (friction * w), 0.0)
            stretch += friction * w / (2 * EA) * (-(lies**2) + (lies - h / (friction * w)) * slack)
        reach = lies + h / w * np.arcsinh(v / h) + stretch
        return [reach - span, h / w * (np.sqrt(1 + (v / h) ** 2) - 1) + v**2 / (2 * EA * w) - rise]

    return np.exp(fsolve(rows, np.log([20.0 * w, 0.5 * w * length]), xtol=1e-13))
