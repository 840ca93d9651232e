"""A site in memory: the scene, its parts, and the scenes of its load cases."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.base.records import names_of, select_keys, without_keys
from dropper_jax.load.scene import Scene
from dropper_jax.scene import whole_lines
from dropper_jax.sea.spec import SeaSpec
from fitting.farm.site.case import Case, Storm
from fitting.farm.site.case_lists import CaseLists
from fitting.farm.site.parts import Anchor, Part
from fitting.farm.site.patterns import match_names
from fitting.farm.site.sections import Backbone, Exclusion, Factors, RunValues, SeasonValues, SeaState
from fitting.farm.site.states import Break, kinds_of

#: Keys of a scene's `[run]` that determine its steps and when they are saved.
STEP_KEYS = ("dt", "accuracy", "save_every", "save_interval")
#: Longest time [s] between the samples of loads; extremes are those of all steps.
LONGEST_INTERVAL = 0.1
#: Time [s] of breaks that belong to other cases: their entries stay in the one compiled program.
NEVER = 1e9
#: Fields of a current that cases keep: its profile over depth, but not its change in time.
PROFILE = ("kind", "exponent", "reference", "veer")
#: Growth of a line in a month without any.
BARE = {"depth": [0.0], "thickness": [0.0], "density": 0.0}


def water_of(scene: Scene) -> SeaSpec:
    """The water of a site's scene.

    Raises:
        SceneError: a scene without water.
    """
    if scene.sea is None:
        raise SceneError(f"scene: {scene.name!r} has no [sea]. Use a scene with water")
    return scene.sea


@dataclass(frozen=True, eq=False)
class Site:
    """A site, read and checked.

    Attributes:
        scene: the farm with the values of `[parameters]` and `[set]`; its template is kept.
        growth: mussels by month, and by line the table of `[line.growth]`.
        crop: changes of the scene by `low`, `expected` and `high` of `[crop]`; `growth` is a factor of the thickness.
        states: the broken line; None for the intact farm.
        quantities: names of further quantities to report for each case (see `dropper_jax.quantities.quantity_names`).
        raw: sections that are passed on (`variable`, `objective`, `constraint`, `optimise`), unchanged.
        table: plain values of the site as specified.
        file: source file; None for plain values.
    """

    name: str
    description: str
    scene: Scene
    run: RunValues
    sea_states: tuple[SeaState, ...]
    lists: CaseLists
    growth: dict[str, dict[str, Table]]
    states: tuple[Break | None, ...]
    factors: Factors
    parts: tuple[Part, ...]
    anchors: tuple[Anchor, ...]
    crop: dict[str, dict[str, float]]
    quantities: tuple[str, ...]
    raw: Table
    table: Table
    file: Path | None
    exclusion: Exclusion | None = None
    backbone: Backbone | None = None
    season: SeasonValues | None = None

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """Names of the scene's lines as specified."""
        return tuple(names_of(whole_lines(self.scene)))

    def matching(self, patterns: Iterable[str]) -> tuple[str, ...]:
        """Lines that match the patterns."""
        return match_names(patterns, self.lines, "lines")

    @property
    def sea(self) -> SeaSpec:
        """The water of its scene."""
        return water_of(self.scene)

    @cached_property
    def storms(self) -> tuple[Storm, ...]:
        """All load cases, with a standard those of its return periods; states vary fastest, sea states slowest.

        Raises:
            SceneError: a pair of return periods without a sea state or a current.
        """
        lists = self.lists
        combined = []
        for sea, direction, current, level, month, crop, state in itertools.product(
            self.sea_states,
            np.radians(lists.directions).tolist(),
            lists.currents or (None,),
            lists.levels,
            lists.months or (None,),
            lists.crops or tuple(self.crop) or (None,),
            self.states,
        ):
            own = current or {}
            table = None if current is None else self._current_table(current, direction)
            periods = (sea.return_period, own.get("return_period"))
            combined.append(Storm(0, sea, direction, table, own.get("name"), level, month, state, crop, periods))
        if lists.standard is not None:
            pairs = lists.standard["pairs"]
            for waves, current in pairs:
                if (waves, current) not in {storm.periods for storm in combined}:
                    raise SceneError(
                        f"cases.pairs: waves of {waves}, current of {current} years: missing; needed: a [[sea_state]] "
                        "and a current with these, each as `return_period`"
                    )
            combined = [storm for storm in combined if list(storm.periods) in pairs]
        return tuple(replace(storm, number=i) for i, storm in enumerate(combined))

    def _current_table(self, given: Table, direction: float) -> Table:
        """`[sea.current]` of a case: with the scene's profile over depth, and with the waves if it has no direction."""
        table = {}
        own = self.sea.current
        if own is not None and "kind" not in given:
            table = select_keys(own.table(), PROFILE)
        table |= without_keys(given, ("name", "return_period"))
        heading = self.lists.current_direction
        if heading is not None:
            direction = float(np.radians(heading))
        table.setdefault("direction", direction)
        return table

    def portable(self) -> Table:
        """Plain values for `read_site`, independent of files: they contain the scene's values instead of its name."""
        own = without_keys(self.table, ("parameters", "set"))
        return own | {"name": self.name, "scene": self.scene.as_written()}

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of each sea state."""
        return tuple(range(self.run.first_seed, self.run.first_seed + self.run.seeds))

    @cached_property
    def cases(self) -> tuple[Case, ...]:
        """All runs: every load case with every seed, seeds fastest."""
        return tuple(Case(storm, seed) for storm in self.storms for seed in self.seeds)

    @property
    def break_time(self) -> float:
        """Time of breaks [s]."""
        if self.lists.break_time is not None:
            return self.lists.break_time
        return 0.5 * (self.run.skip + self.run.duration)  # the middle of the counted time

    @property
    def ramp(self) -> float | None:
        """Time [s] in which waves rise: the site's, otherwise its scene's, otherwise the time that is not counted."""
        return self.run.ramp or self.sea.ramp or self.run.skip or None

    def run_of(self, storm: Storm) -> RunValues:
        """Values of the run of a load case: if a line breaks, the time before the break is not counted."""
        if storm.broken is None:
            return self.run
        return replace(self.run, skip=max(self.run.skip, self.break_time))

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of states that occur: `intact`, `broken`."""
        return kinds_of(self.states)

    @property
    def curve_lines(self) -> list[str]:
        """Lines of the parts with a fatigue curve."""
        return [name for part in self.parts if part.curve is not None for name in part.lines]

    @property
    def grown_lines(self) -> tuple[str, ...]:
        """Lines that carry mussels in any month of the cases."""
        found = {name for month in self.lists.months for name in self.growth[month]}
        return tuple(name for name in self.lines if name in found)

    @property
    def steps(self) -> dict[str, float]:
        """The `accuracy`, or `dt` [s], of the runs: the site's, otherwise that of its scene."""
        for run in (self.run, self.scene.run):
            for key in ("dt", "accuracy"):
                if getattr(run, key) is not None:
                    return {key: getattr(run, key)}
        raise ValueError("a scene has one of both")

    def finer(self, halvings: int) -> Site:
        """The site with half the step of its runs, so many times: a quarter of the accuracy, in second order."""
        share = {"dt": 0.5**halvings, "accuracy": 0.25**halvings}
        steps = {key: share[key] * value for key, value in self.steps.items()}
        table = {**self.table, "run": {**self.table["run"], **steps}}
        return replace(self, run=replace(self.run, **steps), table=table)

    def prepared(self, scene: Scene | None = None) -> Scene:
        """The common scene of all cases: with the run's values, and with every table that cases change.

        Args:
            scene: another version of the farm, with the same names; default: `site.scene`.

        Raises:
            SceneError: as for any scene.
        """
        scene = scene or self.scene
        table = scene.as_written()
        run = without_keys(table["run"], STEP_KEYS)
        if "accuracy" in self.steps:
            run["save_interval"] = min(scene.run.interval, LONGEST_INTERVAL)
        table["run"] = {**run, "duration": self.run.duration, **self.steps}
        for line in table["line"]:
            if line.get("name") in self.grown_lines:
                line["growth"] = dict(BARE)
        broken = [{"line": s.line, "link": s.link, "time": NEVER} for s in self.states if s is not None]
        if broken:
            table["failure"] = [*table.get("failure", []), *broken]
        if self.ramp is not None:
            table["sea"] = {**table["sea"], "ramp": self.ramp}
        return Scene.from_dict(table, scene.name).with_values(self.changes(self.cases[0]))

    def changes(self, case: Case) -> Table:
        """Changes of `prepared` by a case: values by path."""
        return {**self.still_changes(case.storm), **self.moving_changes(case)}

    def moving_changes(self, case: Case) -> Table:
        """Its values that do not affect the equilibrium: waves, breaks."""
        storm = case.storm
        return {"sea.waves": storm.sea_state.waves(storm.direction, case.seed), **self.break_changes(storm)}

    def still_changes(self, storm: Storm) -> Table:
        """Its values that affect the equilibrium: level, current, mussels."""
        found: Table = {"sea.level": {"offset": storm.level}}
        if storm.current is not None:
            found["sea.current"] = storm.current
        crop = self.crop.get(storm.crop, {})
        found |= {path: value for path, value in crop.items() if path != "growth"}
        mussels = self.growth.get(storm.month, {})
        for name in self.grown_lines:
            table = dict(mussels.get(name, BARE))
            table["thickness"] = [crop.get("growth", 1.0) * t for t in table["thickness"]]
            found |= {f"line.{name}.growth.{key}": value for key, value in table.items()}
        return found

    def break_changes(self, storm: Storm) -> Table:
        """Time of a break in this case, for each line that breaks in any case."""
        found = {}
        for state in self.states:
            if state is not None:
                time = self.break_time if state == storm.broken else NEVER
                found[f"failure.{state.entry}.time"] = time
        return found
