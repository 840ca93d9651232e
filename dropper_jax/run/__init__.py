"""Run a scene to a solution, and store it."""
