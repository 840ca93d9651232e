"""Checks of a site: times of runs, hours of a year, currents, mussels and crops of all cases, breaking seas."""

from __future__ import annotations

from collections.abc import Sequence

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import refuse
from dropper_jax.load.sea_warnings import SHALLOW_HEIGHT, mean_period, steepest_sea
from dropper_jax.sea.make import make_sea
from dropper_jax.sea.spec import SeaSpec
from fitting.farm.site.case_lists import CaseLists
from fitting.farm.site.sections import HOURS_PER_YEAR, RunValues, SeaState
from fitting.farm.site.site import Site


def check_times(run: RunValues, lists: CaseLists, broken: bool) -> None:
    """Reject a run without counted time, or a break outside the counted time."""
    if run.skip >= run.duration:
        raise refuse("run.skip", run.skip, "covers the whole run", f"0 to less than {run.duration:g} s")
    if broken and lists.break_time is not None and not run.skip <= lists.break_time < run.duration:
        allowed = f"{run.skip:g} to less than {run.duration:g} s"
        raise refuse("cases.break_time", lists.break_time, "is outside the counted part of the run", allowed)


def check_hours(states: Sequence[SeaState]) -> None:
    """Reject sea states that last longer than a year together: their damages of a year are added."""
    total = sum(state.hours or 0.0 for state in states)
    if total > HOURS_PER_YEAR:
        raise refuse("sea_state.hours", total, "of all sea states is more than a year", f"<= {HOURS_PER_YEAR:g} h")


def check_currents(site: Site) -> None:
    """Check that currents are of one kind, because cases share a compiled program."""
    kinds = {storm.current.get("kind", "uniform") for storm in site.storms if storm.current is not None}
    if len(kinds) > 1:
        raise refuse("cases.currents", sorted(kinds), "are of different kinds", "currents of one kind")
    if "table" in kinds and any("velocities" not in (s.current or {}) for s in site.storms):
        raise SceneError(
            "cases.currents: the scene's current is a table of heights, which a speed cannot scale. Use tables as "
            "[sea.current] with heights and velocities"
        )


def check_waters(site: Site) -> None:
    """Reject currents, mussels and values of `[crop]` that the scene does not take.

    Raises:
        SceneError: with the first load case that has them.
    """
    base = site.prepared()
    storms = site.storms
    distinct = {storm.current_name: storm for storm in reversed(storms)}
    for storm in (*distinct.values(), *{(storm.month, storm.crop): storm for storm in reversed(storms)}.values()):
        try:
            base.with_values(site.still_changes(storm))
        except SceneError as error:
            raise SceneError(f"cases: {storm.name}: {error}") from None


def check_breaking(site: Site) -> None:
    """Reject a sea state beyond breaking at any level of the tide, by depth or by steepness.

    `Hs <= 0.6 (depth + level)`, and Hs at most that of the steepest seas of the mean period Tz (DNV-RP-C205, as in
    `dropper sea`).

    Raises:
        SceneError: with the sea state, its height, and the limit.
    """
    spec = site.sea
    levels = site.lists.levels
    for level in levels:
        if spec.depth + level <= 0.0:
            raise SceneError(f"cases.levels: {level:g} m is below the seabed; allowed: above {-spec.depth:g} m")
    lowest = min(levels)
    for i, state in enumerate(site.sea_states):
        hs = state.sea.hs
        if not hs:
            continue
        sea = make_sea(SeaSpec(depth=spec.depth, density=spec.density, gravity=spec.gravity, waves=state.sea))
        tz = mean_period(sea)
        limit = SHALLOW_HEIGHT * (spec.depth + lowest)
        why = f"0.6 of the depth of {spec.depth + lowest:g} m at the level of {lowest:+g} m"
        steepest = steepest_sea(tz, spec.gravity)
        if steepest < limit:
            limit = steepest
            why = f"the steepest seas of mean period {tz:.3g} s (DNV-RP-C205)"
        if hs > limit:
            raise SceneError(
                f"sea_state.{i}.hs: {state.name!r} of {hs:g} m breaks; allowed: at most {limit:.3g} m, {why}"
            )
