"""Values in a form that JSON can represent."""

from __future__ import annotations

import math
from typing import Any

from dropper_jax.base.renamed import with_old_keys

Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]
#: Version of the JSON object that commands print.
SCHEMA = 1


def jsonable(value: Any) -> Json:
    """Plain JSON values: arrays and tuples as lists, NaN and infinity as None."""
    if isinstance(value, dict):
        return with_old_keys({str(key): jsonable(item) for key, item in value.items()})
    if hasattr(value, "tolist"):
        return jsonable(value.tolist())
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
