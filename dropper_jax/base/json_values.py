"""Plain JSON values of what commands print and files contain."""

from __future__ import annotations

import math
from dataclasses import is_dataclass
from typing import Any, overload

Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]
#: Version of the JSON object that commands print.
SCHEMA = 1


@overload
def jsonable(value: dict[str, Any]) -> dict[str, Any]: ...
@overload
def jsonable(value: Any) -> Json: ...
def jsonable(value: Any) -> Json:
    """Plain JSON values: arrays and tuples as lists, NaN and infinity as None, objects as `to_json` or their fields."""
    match value:
        case dict():
            return {str(key): jsonable(item) for key, item in value.items()}
        case list() | tuple():
            return [jsonable(item) for item in value]
        case _ if hasattr(value, "tolist"):
            return jsonable(value.tolist())
        case _ if hasattr(value, "to_json"):
            return jsonable(value.to_json())
        case _ if is_dataclass(value):
            return jsonable(vars(value))
        case float() if not math.isfinite(value):
            return None
    return value
