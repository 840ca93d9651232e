"""Designs found by their gradients: `dropper optimise SITE.toml`."""
