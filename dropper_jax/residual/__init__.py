"""The residual of a step: unknowns, rows, and Newton's method on them."""
