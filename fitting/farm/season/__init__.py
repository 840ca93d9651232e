"""The season of a site: monthly mussel weight, the floats that carry it, and a schedule with minimum handling.

A float of volume V and density rho_f has the lift `g V (rho - rho_f)` under water. Let B be the downward force of all
lines on the points that carry floats, at rest with these points fixed at their positions in the scene. The farm cannot
sink with `n >= reserve B/lift` floats, with B the maximum over the currents. It cannot rise out of the water with
`n <= B/(least_share lift)`, with B the minimum over the currents. Equilibria on these floats, at every level of the
tide and in every current, then give the depth of the backbone.
"""

from fitting.farm.season.report import write_season
from fitting.farm.season.schedule import float_schedule
from fitting.farm.season.season import plan_season

__all__ = ["float_schedule", "plan_season", "write_season"]
