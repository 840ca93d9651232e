"""A site in memory: the scene, its parts, and the scenes of its load cases."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

from dropper_jax.load.scene import Scene
from dropper_jax.scene import whole_lines
from fitting.site.case import BROKEN, INTACT, NEVER, Break, Case, Storm, storms
from fitting.site.parts import Anchor, Part, match_names
from fitting.site.sections import Backbone, CaseLists, Exclusion, Factors, RunValues, SeasonValues, SeaState

#: Growth of a line in a month without any.
BARE = {"depth": [0.0], "thickness": [0.0], "density": 0.0}


@dataclasses.dataclass(frozen=True, eq=False)
class Site:
    """A site, read and checked.

    Attributes:
        scene: the farm with `[parameters]` and `[set]` put in; its template is kept.
        growth: mussels by month, and by line the table of `[line.growth]`.
        states: what breaks; None where nothing does.
        raw: sections that are passed on (`variable`, `objective`, `constraint`, `optimise`), as they were written.
        table: plain values of the site as it was written.
        file: where it was read; None for plain values.
    """

    name: str
    description: str
    scene: Scene
    run: RunValues
    sea_states: tuple[SeaState, ...]
    lists: CaseLists
    growth: dict[str, dict[str, dict[str, Any]]]
    states: tuple[Break | None, ...]
    factors: Factors
    parts: tuple[Part, ...]
    anchors: tuple[Anchor, ...]
    exclusion: Exclusion | None = None
    backbone: Backbone | None = None
    season: SeasonValues | None = None
    raw: dict[str, Any] = dataclasses.field(default_factory=dict)
    table: dict[str, Any] = dataclasses.field(default_factory=dict)
    file: Path | None = None

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """Names of the scene's lines as they were written."""
        return tuple(line.name for line in whole_lines(self.scene))

    def matching(self, patterns: Iterable[str]) -> tuple[str, ...]:
        """Lines that the patterns find."""
        return match_names(patterns, self.lines, "lines")

    @cached_property
    def storms(self) -> tuple[Storm, ...]:
        """All load cases."""
        return storms(self)

    def portable(self) -> dict[str, Any]:
        """Plain values from which `read_site` makes the same site anywhere, those of the scene in place of its name."""
        own = {key: value for key, value in self.table.items() if key not in ("parameters", "set")}
        return {**own, "name": self.name, "scene": self.scene.as_written()}

    @property
    def seeds(self) -> tuple[int, ...]:
        return tuple(range(self.run.first_seed, self.run.first_seed + self.run.seeds))

    @cached_property
    def cases(self) -> tuple[Case, ...]:
        """All runs: every load case with every seed, seeds fastest."""
        return tuple(Case(storm, seed) for storm in self.storms for seed in self.seeds)

    @property
    def break_time(self) -> float:
        """When lines break [s]."""
        given = self.lists.break_time
        return 0.5 * (self.run.skip + self.run.duration) if given is None else given

    def run_of(self, storm: Storm) -> RunValues:
        """Values of the run of a load case: where a line breaks, what comes before counts for nothing."""
        if storm.broken is None:
            return self.run
        return dataclasses.replace(self.run, skip=max(self.run.skip, self.break_time))

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of states that are there: `intact`, `broken`."""
        found = {INTACT if state is None else BROKEN for state in self.states}
        return tuple(kind for kind in (INTACT, BROKEN) if kind in found)

    @property
    def grown_lines(self) -> tuple[str, ...]:
        """Lines that carry mussels in any month of the cases."""
        found = {name for month in self.lists.months for name in self.growth[month]}
        return tuple(name for name in self.lines if name in found)

    def prepared(self, scene: Scene | None = None, dt: float | None = None) -> Scene:
        """The scene that all cases are changes of: with the run's values, and with all that cases change in place.

        Args:
            scene: another version of the farm, with the same names; `site.scene` where left out.
            dt: time step [s], where it is not the site's.

        Raises:
            SceneError: as for any scene.
        """
        scene = self.scene if scene is None else scene
        table = scene.as_written()
        own = {"duration": self.run.duration, **({} if self.run.dt is None else {"dt": self.run.dt})}
        table["run"] = {**table["run"], **own, "save_every": 1, **({} if dt is None else {"dt": dt})}
        for line in table["line"]:
            if line.get("name") in self.grown_lines:
                line["growth"] = dict(BARE)
        broken = [state for state in self.states if state is not None]
        if broken:
            entries = [{"line": state.line, "link": state.link, "time": NEVER} for state in broken]
            table["failure"] = [*table.get("failure", []), *entries]
        sea = dict(table["sea"])
        ramp = self.run.ramp or sea.get("ramp") or (self.run.skip or None)
        table["sea"] = {**sea, **({} if ramp is None else {"ramp": ramp})}
        base = Scene.from_dict(table, scene.name)
        return base.with_values(self.changes(self.cases[0]))

    def changes(self, case: Case) -> dict[str, Any]:
        """What a case changes in `prepared`: values by path."""
        return {**self.still_changes(case.storm), **self.moving_changes(case)}

    def moving_changes(self, case: Case) -> dict[str, Any]:
        """What of it the pose at rest does not depend on: waves, breaks."""
        storm = case.storm
        return {"sea.waves": storm.sea_state.waves(storm.direction, case.seed), **self.break_changes(storm)}

    def still_changes(self, storm: Storm) -> dict[str, Any]:
        """What of it the pose at rest depends on: current, level, mussels."""
        found: dict[str, Any] = {"sea.level": {"offset": storm.level}}
        if storm.current is not None:
            found["sea.current"] = storm.current
        for name in self.grown_lines:
            table = self.growth[storm.month].get(name, BARE)
            found |= {f"line.{name}.growth.{key}": value for key, value in table.items()}
        return found

    def break_changes(self, storm: Storm) -> dict[str, Any]:
        """When what breaks in any case breaks in this one."""
        return {
            f"failure.{state.entry}.time": self.break_time if state == storm.broken else NEVER
            for state in self.states
            if state is not None
        }
