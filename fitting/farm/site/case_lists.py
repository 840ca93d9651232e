"""`[cases]` of a site: lists of values that load cases combine, and pairs of return periods of a standard."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import Plain, Table, Values, plain, read_list, read_number, read_text, refuse
from dropper_jax.base.records import column
from fitting.farm.site.sections import Section, read_years, standards


@dataclass(frozen=True)
class CaseLists(Section):
    """`[cases]`: values to be combined."""

    directions: Sequence[float] = parameter("travel directions of the waves", unit="deg", shape="table", default=(0.0,))
    currents: tuple[Table, ...] = ()
    current_direction: float | None = None
    levels: Sequence[float] = parameter("of the tide", unit="m", shape="table", default=(0.0,))
    months: tuple[str, ...] = option("months of [[growth]]", type=list, default=())
    states: tuple[str, ...] = option("intact, and lines that break", type=list, default=("intact",))
    break_time: float | None = parameter("when lines break", unit="s", above=0.0, default=None)
    crops: tuple[str, ...] = option("values of [crop]", type=list, default=())
    standard: Table | None = None

    @classmethod
    def values_of(cls, table: Values, path: str) -> Table:
        """Currents become tables with `name`; those without `direction` use the common one."""
        own = dict(table)
        standard = _case_standard(own, path)
        currents = own.pop("currents", [])
        heading = own.pop("current_direction", "waves")
        if heading == "waves":
            heading = None
        else:
            allowed = "'waves', or a number in deg"
            heading = read_number(heading, f"{path}.current_direction", {"unit": "deg"}, allowed)
        found = super().values_of(own, path)
        for key in ("directions", "levels"):
            if len(found[key]) == 0:
                raise refuse(f"{path}.{key}", [], "is empty", "at least one; or leave the key out")
            found[key] = list(map(float, found[key]))
            if len(set(found[key])) < len(found[key]):
                raise refuse(f"{path}.{key}", found[key], "has a duplicate value", "every value once")
        found["current_direction"] = heading
        allowed = "a list of speeds [m/s], or of tables as [sea.current]"
        currents = read_list(currents, f"{path}.currents", None, allowed)
        tables = [_current(item, f"{path}.currents.{i}") for i, item in enumerate(currents)]
        names = column(tables, "name")
        if len(set(names)) < len(names):
            raise refuse(f"{path}.currents", names, "has a duplicate current", "every current once")
        return found | {"currents": tuple(tables), "standard": standard}


def _case_standard(table: Table, path: str) -> Table | None:
    """Pairs of return periods, taken out of `[cases]`: those of a standard, or the site's `pairs`; None without any."""
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
        allowed = "pairs of return periods of waves and current [years]"
        given = read_list(given, f"{path}.pairs", None, allowed)
        if not given:
            raise refuse(f"{path}.pairs", [], "is empty", f"{allowed}; or leave the key out")
        found["pairs"] = []
        for i, row in enumerate(given):
            where = f"{path}.pairs.{i}"
            waves, current = read_list(row, where, 2, "[waves, current]")
            found["pairs"].append([read_years(waves, where), read_years(current, where)])
        found["source"] = "; ".join(filter(None, (found["source"], "pairs: given for this site")))
    if not found.get("pairs"):
        raise SceneError(
            f"{path}.standard: the return periods of {name!r} are not known here. Use `pairs` with those of waves and "
            "current, such as [[50, 10], [10, 50]]"
        )
    return {"name": name, **found}


def _current(item: Plain, path: str) -> Table:
    """A current as a table with a name; a number is its speed."""
    if not isinstance(item, Mapping):
        speed = read_number(item, path, {"low": 0.0, "unit": "m/s"}, "a speed >= 0 m/s, or a table as [sea.current]")
        return {"name": f"{speed:g} m/s", "speed": speed}
    found: Table = {key: plain(value) for key, value in item.items()}
    speed = found.get("speed")
    own = f"{speed:g} m/s" if isinstance(speed, int | float) else "given"
    if "return_period" in found:
        found["return_period"] = read_years(found["return_period"], f"{path}.return_period")
    return {**found, "name": read_text(found.get("name", own), f"{path}.name")}
