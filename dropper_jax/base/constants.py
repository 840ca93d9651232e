"""Physical constants, default values for what a scene does not specify, and units."""

import math

#: Acceleration of gravity [m/s^2].
GRAVITY = 9.81
#: Density of sea water [kg/m^3].
SEA_WATER = 1025.0
#: Kinematic viscosity of sea water at 10 degrees [m^2/s].
VISCOSITY = 1.35e-6
#: Degrees in a radian.
DEGREE = 180.0 / math.pi
