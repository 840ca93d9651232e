"""Physical constants that are defaults where a scene has no value of its own."""

#: Acceleration of gravity [m/s^2].
GRAVITY = 9.81
#: Density of sea water [kg/m^3].
SEA_WATER = 1025.0
