"""`[cases]` of a site: lists of values that load cases combine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import Plain, Table, Values, plain, read_list, read_number, read_text, refuse
from dropper_jax.base.records import column
from fitting.farm.site.sections import Section
from fitting.farm.site.standards import pop_return_periods, read_years

#: Directions [deg] that differ by this are the same.
FULL_TURN = 360.0


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
        """Currents become tables with `name`; those without `direction` use the common one, None: that of the waves."""
        own = dict(table)
        standard = pop_return_periods(own, path)
        currents = _currents(own.pop("currents", []), f"{path}.currents")
        heading = own.pop("current_direction", "waves")
        if heading == "waves":
            heading = None
        else:
            allowed = "'waves', or a number in deg"
            heading = read_number(heading, f"{path}.current_direction", {"unit": "deg"}, allowed)
        found = super().values_of(own, path)
        found["levels"] = _distinct_numbers(found["levels"], f"{path}.levels")
        found["directions"] = _distinct_numbers(found["directions"], f"{path}.directions", FULL_TURN)
        return found | {"current_direction": heading, "currents": currents, "standard": standard}


def _distinct_numbers(values: Sequence[float], path: str, period: float | None = None) -> list[float]:
    """The values; rejects none at all, and duplicates, with a period also values that differ by it."""
    found = list(map(float, values))
    if not found:
        raise refuse(path, [], "is empty", "at least one; or leave the key out")
    phases = found if period is None else np.mod(found, period).tolist()
    if len(set(phases)) < len(found):
        raise refuse(path, found, "has a duplicate value", "every value once")
    return found


def _currents(given: Plain, path: str) -> tuple[Table, ...]:
    """Currents as tables with names; rejects duplicate names."""
    items = read_list(given, path, None, "a list of speeds [m/s], or of tables as [sea.current]")
    tables = tuple(_current(item, f"{path}.{i}") for i, item in enumerate(items))
    names = column(tables, "name")
    if len(set(names)) < len(names):
        raise refuse(path, names, "has a duplicate current", "every current once")
    return tables


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
