"""Farms: sites with load cases and standards, the season of the mussels, and designs by gradients."""
