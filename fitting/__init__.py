"""Fitting simulated droppers to measured traces; it builds on `dropper_jax`, never the other way round."""
