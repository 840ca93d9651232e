"""Fits of any scene to any channel of measurement: angles, positions in space or in a film, tensions, depths."""
