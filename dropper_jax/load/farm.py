"""Farms of any size by name: `dropper-farm-K` is the packaged scene `dropper-farm` with K droppers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from dropper_jax.base.errors import SceneError

NAME = re.compile(r"dropper-farm(?:-(\d+))?")
MOST = 200


def is_farm(name: str) -> bool:
    """Whether a scene name is that of a farm, `dropper-farm` or `dropper-farm-K`."""
    return NAME.fullmatch(name) is not None


def farm_table(name: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values of `dropper-farm-K` from those of `dropper-farm`.

    Raises:
        SceneError: K out of range.
    """
    digits = NAME.fullmatch(name).group(1)
    if digits is None:
        return dict(table)
    droppers = int(digits)
    if not 1 <= droppers <= MOST:
        raise SceneError(f"scene: {name!r} has {droppers} droppers; allowed: dropper-farm-1 to dropper-farm-{MOST}")
    return {**table, "name": name, "parameters": {**table["parameters"], "droppers": droppers}}
