"""Physical constants, defaults where a scene has no value of its own, and units."""

import math

#: Acceleration of gravity [m/s^2].
GRAVITY = 9.81
#: Density of sea water [kg/m^3].
SEA_WATER = 1025.0
#: Degrees in a radian.
DEGREE = 180.0 / math.pi
