"""Priors of the free parameters from the rig's known numbers (`[fit]` of a scene)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import ScenePath
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.scene import PriorSpec
from fitting.parameters.names import full_names
from fitting.parameters.parameter import Parameter
from fitting.parameters.paths import resolve
from fitting.parameters.scene_parameters import find_parameters


@dataclass(frozen=True)
class CommonPrior:
    """A prior of a mean relative change: `share . values` is 1 with standard deviation `sigma`."""

    share: np.ndarray
    sigma: float


@dataclass(frozen=True)
class JointPrior:
    """Joint prior knowledge of the parameters.

    Attributes:
        common: priors of several of them.
        carried: relative standard deviation of the scale of mass, which traces of angles cannot determine.
        massive: power of mass in every parameter's unit (k,).
        doubt: moves of the parameters (k,) by indistinguishable candidates, each one standard deviation.
    """

    common: tuple[CommonPrior, ...] = ()
    carried: float = 0.0
    massive: np.ndarray | None = None
    doubt: tuple[np.ndarray, ...] = ()

    def carried_covariance(self, values: np.ndarray) -> np.ndarray:
        """Covariance (k, k) of the parameters by `carried` and `doubt`."""
        moves = [np.zeros(len(values)), *self.doubt]
        if self.massive is not None and self.carried:
            moves.append(self.carried * self.massive * values)
        return np.sum([np.outer(move, move) for move in moves], axis=0)


def rig_priors(scene: Scene, model: Model, parameters: Sequence[Parameter]) -> tuple[tuple[Parameter, ...], JointPrior]:
    """The parameters with the rig's priors, unless the caller gave some, and their joint prior.

    Priors are about the values of the scene, also of parameters that start elsewhere.

    Raises:
        SceneError: the prior of a number that the scene does not have, or with another unit than the number's.
    """
    found = list(parameters)
    common = []
    carried = 0.0
    priors = []
    if scene.fit is not None:
        priors = scene.fit.priors
    for i, prior in enumerate(priors):
        path = f"fit.prior.{i}"
        known = {p.name: p for p in _resolve_prior(scene, model, prior.of, f"{path}.of")}
        own = {j: known[p.name] for j, p in enumerate(found) if p.name in known}
        sigma = prior.in_si_units[0]
        if prior.common and own:
            share = np.zeros(len(found))
            for j, p in own.items():
                share[j] = 1 / (len(own) * _nonzero(p, f"{path}.of"))
            common.append(CommonPrior(share, sigma))
        elif not prior.common:
            for j, p in own.items():
                found[j] = replace(found[j], prior=found[j].prior or (p.value, _width(prior, p, path)))
        elif all(p.unit == "kg" for p in known.values()):
            carried = float(np.hypot(carried, sigma))
    massive = np.array([power_of_mass(p.unit) for p in found])
    return tuple(found), JointPrior(tuple(common), carried, massive)


def _resolve_prior(scene: Scene, model: Model, of: str, option: str) -> Sequence[Parameter]:
    """The numbers that a prior applies to: of the model, otherwise of the scene, such as `sea.current.speed`."""
    name = full_names(scene, [of], option)[0]
    if ScenePath(name).section in ("point", "line", "effects") and scene.written is None:
        return resolve(model, [name], option=option)
    return find_parameters(scene, model, [name], option)


def power_of_mass(unit: str) -> int:
    """Power of mass in a unit: 1 of `kg/s` and `N m`, 0 of `m` and `kg/kg`."""
    above, _, below = unit.partition("/")
    return _has_mass(above) - _has_mass(below)


def _has_mass(units: str) -> bool:
    """Whether a product of units, such as `N m^2`, contains one that is proportional to that of mass."""
    return any(word.split("^")[0] in ("kg", "N", "Pa", "J") for word in units.split())


def _width(prior: PriorSpec, p: Parameter, path: str) -> float:
    """Standard deviation of a prior in the unit of the parameter."""
    sigma, unit = prior.in_si_units
    if unit == "%":
        return sigma * abs(_nonzero(p, path))
    if unit != p.unit:
        raise SceneError(f"{path}.unit: {prior.unit!r} is not a unit of {p.name!r}; allowed: {p.unit}, %")
    return sigma


def _nonzero(p: Parameter, path: str) -> float:
    """Its value; 0 is rejected."""
    if p.value == 0:
        raise SceneError(f"{path}: {p.name!r} is 0, which has no relative error; allowed: sigma in {p.unit}")
    return p.value
