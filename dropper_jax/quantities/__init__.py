"""Quantities of saved states by name: forces on ends, bending, twist, motions, and their statistics."""
