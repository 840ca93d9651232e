"""Fits to any named channel of measurement: angles, places in space or in a film, tensions, depths; of any scene."""
