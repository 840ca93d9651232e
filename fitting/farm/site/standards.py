"""Standards by name: factors on loads, and pairs of return periods of waves and current."""

from __future__ import annotations

import tomllib
from importlib import resources

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain, Table, read_list, read_number, read_text, refuse


def standards(what: str) -> dict[str, Table]:
    """`factors` or load `cases` by name of the standard, each with edition and clause."""
    return tomllib.loads((resources.files("dropper_jax") / "data" / "standards.toml").read_text(encoding="utf-8"))[what]


def read_years(value: Plain, path: str) -> str:
    """A return period as text: years, or `associated`."""
    if isinstance(value, str):
        return read_text(value, path)
    return f"{read_number(value, path, {'above': 0.0, 'unit': 'years'}, 'years, or a text'):g}"


def pop_return_periods(table: Table, path: str) -> Table | None:
    """Pairs of return periods, taken out of `[cases]`: those of a standard, or the site's `pairs`; None without any.

    Returns:
        {name, pairs: [[waves, current]] as texts, broken, source, edition, clause, checked}.
    """
    name = table.pop("standard", None)
    given = table.pop("pairs", None)
    if name is None and given is None:
        return None
    known = standards("cases")
    found: Table = {
        "broken": False,
        "source": "",
        "edition": "-",
        "clause": "-",
        "checked": "to be checked by you",
    }
    if name is not None:
        found |= known[read_text(name, f"{path}.standard", known)]
    if given is not None:
        found["pairs"] = _read_pairs(given, f"{path}.pairs")
        found["source"] = "; ".join(filter(None, (found["source"], "pairs: given for this site")))
    if not found.get("pairs"):
        raise SceneError(
            f"{path}.standard: the return periods of {name!r} are not known here. Use `pairs` with those of waves and "
            "current, such as [[50, 10], [10, 50]]"
        )
    return {"name": name, **found}


def _read_pairs(given: Plain, path: str) -> list[list[str]]:
    """Pairs of return periods of waves and current, as texts."""
    allowed = "pairs of return periods of waves and current [years]"
    pairs = []
    for i, row in enumerate(read_list(given, path, None, allowed)):
        own = read_list(row, f"{path}.{i}", 2, "[waves, current]")
        pairs.append([read_years(years, f"{path}.{i}") for years in own])
    if not pairs:
        raise refuse(path, [], "is empty", f"{allowed}; or leave the key out")
    return pairs
