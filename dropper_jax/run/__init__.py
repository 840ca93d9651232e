"""From a scene to a solution, and what is kept of it."""
