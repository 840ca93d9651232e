"""Gradient-based design: `dropper optimise SITE.toml`."""
