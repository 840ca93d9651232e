"""MoorDyn inputs (versions 1 and 2) as plain values of a scene."""
