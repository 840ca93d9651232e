"""A measured file of any program: columns, clock, unit and free swing found by name and content, and a scene for it."""
