"""Source of the coefficients of drag and added mass: the scene's numbers, rough cylinders, or a table over KC."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Values, plain, refuse, rises

#: Sources of coefficients: the scene's numbers, `rough_cylinder`, a table over KC.
SOURCES = ("given", "rough_cylinder", "table")


def from_table(path: str, kc: np.ndarray, re: np.ndarray, values: Values, key: str) -> np.ndarray:
    """Coefficients (links,) interpolated between the rows of a scene's table over KC.

    Raises:
        SceneError: KC or Re is outside the table.
    """
    rows = values["table_kc"]
    _check_inside(f"{path}.table_kc", kc, rows, "KC")
    if values["table_re"] is not None:
        _check_inside(f"{path}.table_re", re, values["table_re"], "Re")
    return np.interp(kc, rows, values[key])


def _check_inside(path: str, found: np.ndarray, table: np.ndarray, name: str) -> None:
    """Reject numbers of links (links,) outside the range of a rising table; `name` is the name of the number."""
    low = table[0]
    high = table[-1]
    worst = found[np.argmax(np.maximum(low - found, found - high))]
    if not low <= worst <= high:
        raise SceneError(f"{path}: {name} = {worst:.4g} of a link is outside the table; allowed: {low:g} to {high:g}")


def check_source(path: str, values: Values, key: str, word: str) -> None:
    """Check tables for consistency, and reject missing values and those of other sources.

    Args:
        key: the coefficient, `cdn` or `can`; its table is `table_{key}`.
    """
    source = values["coefficients"]
    takes = {key: "given", "table_kc": "table", f"table_{key}": "table", "table_re": "table"}
    for name, needed in takes.items():
        if needed != source and values[name] is not None:
            raise refuse(
                f"{path}.{name}", plain(values[name]), f"is not used by coefficients {source!r}", f"with {needed!r}"
            )
    if source == "given" and values[key] is None and key == "cdn":
        raise SceneError(f"{path}.{key}: missing; needed: {word}, >= 0")
    if source != "table":
        return
    kc = values["table_kc"]
    rows = values[f"table_{key}"]
    if kc is None or rows is None or len(kc) != len(rows) or not rises(kc, 2):
        raise SceneError(f"{path}.table_kc: needs at least 2 rising values, as many as `table_{key}`")
    reynolds = values["table_re"]
    if reynolds is not None and (len(reynolds) != 2 or not rises(reynolds)):
        raise refuse(f"{path}.table_re", reynolds, "is not a range", "two rising Reynolds numbers")
