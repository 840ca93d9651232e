"""The season of a site: weight of the mussels month by month, floats that carry it, and a schedule of least handling.

A float of volume V and density rho_f lifts `g V (rho - rho_f)` under water. With B the pull of all lines on the points
that carry floats, in poses at rest with these points held where the scene puts them, the floats of a month are safe
against sinking from `n >= reserve B/lift` on, and against rising out of the water up to `n <= B/(least_share lift)`: B
is the largest there and the least here over the currents. Poses on these floats at every level of the tide and in every
current then say how deep the backbone lies.
"""

from fitting.season.page import write_season
from fitting.season.schedule import schedule
from fitting.season.season import season

__all__ = ["schedule", "season", "write_season"]
