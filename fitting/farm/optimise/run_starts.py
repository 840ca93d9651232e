"""Starts of the runs of a design: calm models and equilibria, each solved once and from the last one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from dropper_jax.model import State
from fitting.farm.optimise.broken_link import link_of, mask_link
from fitting.farm.optimise.calm_model import CalmModel, differentiate_calm_model
from fitting.farm.optimise.equilibria import EquilibriumSlopes, find_equilibrium_slopes
from fitting.farm.optimise.variables import Variable
from fitting.farm.site import Site, Storm


class RunStart(NamedTuple):
    """Start of a run: calm model with its slopes, equilibrium, and the later model of a window with a broken line."""

    calm: CalmModel
    rest: EquilibriumSlopes
    after: CalmModel | None = None


class DesignCache:
    """Results of one design by key, empty again once another design is asked for."""

    def __init__(self) -> None:
        self._x = np.zeros(0)
        self._results: dict[object, Any] = {}

    def at(self, x: np.ndarray) -> dict[object, Any]:
        """The results of a design (p,) so far, to be read and added to."""
        if not np.array_equal(x, self._x):
            self._x = np.array(x)
            self._results = {}
        return self._results


class RunStarts:
    """Starts of windows; each equilibrium is solved from that of the last design.

    Args:
        intact_site: the site without states in which lines break.
    """

    def __init__(self, intact_site: Site, variables: Sequence[Variable]) -> None:
        self.intact_site = intact_site
        self.variables = variables
        self._near: dict[object, State] = {}
        self._cache = DesignCache()

    def at(self, x: np.ndarray, storm: Storm, starts_broken: bool = False) -> RunStart:
        """Start of a window: calm model and equilibrium of a design in the current and level of a load case.

        Args:
            starts_broken: whether a line that breaks is missing from the start on; otherwise all lines are intact
                there.
        """
        key = (*storm.still, storm.state, starts_broken)
        found = self._cache.at(x)
        if key not in found:
            found[key] = self._make_start(x, storm, starts_broken, key)
        return found[key]

    def _make_start(self, x: np.ndarray, storm: Storm, starts_broken: bool, key: object) -> RunStart:
        """The start of a window, whose equilibrium is stored under a key."""
        if storm.broken is None:
            found = differentiate_calm_model(self.intact_site, self.variables, x, storm)
            return RunStart(found, self._rest(found, key))
        whole = self.at(x, replace(storm, broken=None))
        parted = mask_link(whole.calm, link_of(whole.calm.model, storm.broken))
        if starts_broken:
            return RunStart(parted, self._rest(parted, key), parted)
        return RunStart(mask_link(whole.calm, None), whole.rest, parted)

    def _rest(self, found: CalmModel, key: object) -> EquilibriumSlopes:
        """The equilibrium, solved from the last one under this key."""
        own = find_equilibrium_slopes(found, self._near.get(key))
        self._near[key] = own.state
        return own
