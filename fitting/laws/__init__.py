"""Damping laws: their fits to the same windows, which ones the traces leave possible, and what they lack."""
