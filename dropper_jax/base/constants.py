"""Physical constants, default values for what a scene does not specify, and units."""

import math

#: Acceleration of gravity [m/s^2].
GRAVITY = 9.81
#: Density of sea water [kg/m^3].
SEA_WATER = 1025.0
#: Degrees in a radian.
DEGREE = 180.0 / math.pi
