"""A design problem: objective and constraints of a design, with their derivatives, over all cases and seeds.

A constraint on a storm applies to the characteristic load: the mean over the seeds of the peaks, or the most probable
maximum (`maxima_weights`). Each peak is a window's soft peak times the ratio of the whole run's hard peak to it, which
is frozen until windows are chosen again. Cases with a broken line have loads of parts and anchors as constraints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress
from dropper_jax.base.records import names_of
from fitting.farm.optimise.calm_model import (
    ASSUMPTIONS,
    CalmModel,
    differentiate_calm_model,
    has_no_effect,
    shifted_designs,
)
from fitting.farm.optimise.goals import DepthUtilisation, Goals, check_depths
from fitting.farm.optimise.maxima_weights import check_seeds, maxima_weights
from fitting.farm.optimise.run_starts import DesignCache, RunStarts
from fitting.farm.optimise.settings import SearchSettings
from fitting.farm.optimise.storm_runs import StormRuns
from fitting.farm.optimise.strength import part_strength, relate_loads_to_strength
from fitting.farm.optimise.values import Values
from fitting.farm.optimise.variables import Variable, with_design
from fitting.farm.optimise.window_peaks import check_windows
from fitting.farm.optimise.windows import Window, WindowRuns
from fitting.farm.site import Site, Storm
from fitting.farm.site.case import name_waters


class StormConstraint(NamedTuple):
    """The characteristic value of a quantity of a storm, its derivatives (p + a,), and those of each seed (n, p + a),
    whose mean they are."""

    name: str
    value: float
    slope: np.ndarray
    by_seed: np.ndarray


class DesignProblem:
    """The problem.

    Attributes:
        start: the design at the start (p,).
        starts: of the runs of any design.
        storm_runs: runs of the storms of any design.
        quantities: that apply to storms, by kind of state (`Storm.kind`).
        limited: of these the number with a limit: all but a motion that is the objective, which is the last one.

    Raises:
        SceneError: a scene that cannot be designed, variables without effect, contradicting depths, too few seeds.
    """

    def __init__(self, site: Site, variables: Sequence[Variable], goals: Goals, settings: SearchSettings) -> None:
        check_seeds(site.run)
        self.site = site
        self.variables = tuple(variables)
        self.goals = goals
        self.settings = settings
        self.cases = site.cases
        self.start = np.array([v.value for v in variables])
        self._strength = [part_strength(part, site.scene) for part in site.parts]
        self._of_scene = DesignCache()
        intact_site = replace(site, states=(None,))  # windows break their lines themselves
        self.starts = RunStarts(intact_site, self.variables)
        first = differentiate_calm_model(intact_site, self.variables, self.start, self.cases[0].storm)
        check_windows(first.model)
        check_depths(goals.depths, first.model)
        self.quantities = {kind: goals.quantities(site, first.model, kind) for kind in site.kinds}
        self.limited = {kind: len(own) for kind, own in self.quantities.items()}
        if goals.objective.of == "motion":
            self.limited["intact"] -= 1
        self.storm_runs = StormRuns(site, self.variables, settings, self.starts, self.quantities, self.limited)
        self._check_effects(first)

    def _check_effects(self, first: CalmModel) -> None:
        """Reject variables that change neither the model nor what the scene costs and carries."""
        costs = np.any(self.scene_constraints(self.start)[1] != 0, axis=0)
        named = [repr(v.name) for k, v in enumerate(self.variables) if has_no_effect(first, k) and not costs[k]]
        if named:
            raise SceneError(f"variable: {', '.join(named)} moves nothing. Use numbers that do")

    def scene_constraints(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Properties of a design without a run: material, then the strength of each part over that at the start.

        Returns:
            (1 + parts,) and the derivatives by the variables (1 + parts, p).
        """
        found = self._of_scene.at(x)
        if not found:
            slopes = []
            for distance, higher, lower in shifted_designs(self.variables, x):
                slopes.append((self._evaluate_scene(higher) - self._evaluate_scene(lower)) / distance)
            found["constraints"] = (self._evaluate_scene(x), np.stack(slopes, axis=1))
        return found["constraints"]

    def _evaluate_scene(self, x: np.ndarray) -> np.ndarray:
        """Material, then the strength of each part over that at the start (1 + parts,)."""
        scene = with_design(self.site.scene, self.variables, x)
        strength = np.array([part_strength(part, scene) for part in self.site.parts]) / self._strength
        return np.array([self.goals.objective.material(scene), *strength])

    def depths(self, x: np.ndarray, storm: Storm) -> list[DepthUtilisation]:
        """Depths of a design at rest, all lines intact, in the water of a load case."""
        start = self.starts.at(x, replace(storm, broken=None))
        found = []
        for depth in self.goals.depths:
            r = np.asarray(start.rest.state.r)
            found += depth.utilisations(start.calm.model, r, start.rest.dr, storm.level)
        return found

    def measure(self, x: np.ndarray, say: Progress) -> tuple[tuple[Window, ...], Values]:
        """Windows around the peak loads of the whole runs of a design, and its values by the hard peaks of these runs,
        without derivatives of storm quantities.

        Raises:
            SceneError: a run that failed.
        """
        full_runs = self.storm_runs.run_full_storms(x, say)
        windows = self.storm_runs.choose_windows(x, full_runs, say)
        return windows, self._combine(x, [storm.hard for storm in full_runs], (), True)

    def values(self, runs: WindowRuns) -> Values:
        """Objective and constraints of a design by its windows; derivatives of storms are 0 where they are unknown."""
        return self._combine(runs.x, runs.peaks, runs.slopes, runs.solved)

    def _combine(self, x: np.ndarray, hard: Sequence[np.ndarray], slope: Sequence[np.ndarray], solved: bool) -> Values:
        """Objective and constraints from the quantities (q,) of every case and their slopes (q, p + a), 0 if empty."""
        if not slope:
            slope = [np.zeros((len(peaks), len(self.variables) + len(ASSUMPTIONS))) for peaks in hard]
        (material, *strength), of_scene = self.scene_constraints(x)
        of_scene = np.pad(of_scene, ((0, 0), (0, len(ASSUMPTIONS))))
        hard, slope = relate_loads_to_strength(hard, slope, np.array(strength), of_scene[1:])
        objective = float(material)
        objective_slope = of_scene[0]
        if self.goals.objective.of != "material":
            objective, objective_slope = self._worst_case(hard, slope)
        of_storms = self._storm_constraints(hard, slope)
        rows = [*(one[:3] for one in of_storms), *self._depth_constraints(x)]
        names, value, slopes = zip(*rows, strict=True)
        by_seed = {one.name: one.by_seed for one in of_storms}
        return Values(objective, objective_slope, names, np.array(value), np.array(slopes), solved, by_seed)

    def _storm_constraints(self, hard: Sequence[np.ndarray], slope: Sequence[np.ndarray]) -> list[StormConstraint]:
        """The constraints of all storms from the quantities (q,) of every case and their slopes (q, p + a)."""
        found = []
        seeds = len(self.site.seeds)
        for i, storm in enumerate(self.site.storms):
            own = slice(i * seeds, (i + 1) * seeds)  # seeds vary fastest
            peaks = np.array(hard[own])
            share = maxima_weights(peaks, self.site.run_of(storm))
            shares = share[:, :, None] * np.array(slope[own])
            for q in range(self.limited[storm.kind]):
                name = f"{self.quantities[storm.kind][q].name}: {storm.name}"
                value = float(share[:, q] @ peaks[:, q])
                found.append(StormConstraint(name, value, shares[:, q].sum(axis=0), seeds * shares[:, q]))
        return found

    def _depth_constraints(self, x: np.ndarray) -> list[DepthUtilisation]:
        """Depths at rest in every water of the storms, with its name if there are several."""
        found = []
        storms = list({storm.still: storm for storm in self.site.storms}.values())
        for storm, water in zip(storms, name_waters(storms), strict=True):
            label = f": {water}" if len(storms) > 1 else ""
            found += [depth._replace(name=depth.name + label) for depth in self.depths(x, storm)]
        return found

    def _worst_case(self, hard: Sequence[np.ndarray], slope: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
        """The objective if it depends on storms: the maximum of all intact cases, and its slope (p + a,)."""
        of = self.goals.objective
        q = -1  # a motion is the last quantity
        if of.of != "motion":
            q = names_of(self.site.parts).index(of.part)
        intact = [i for i, case in enumerate(self.cases) if case.storm.broken is None]
        worst = max(intact, key=lambda i: hard[i][q])
        return hard[worst][q], slope[worst][q]
