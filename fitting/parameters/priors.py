"""What a rig knows of its numbers (`[fit]` of a scene), as priors of the parameters that are free.

An independent prior holds every free parameter of its path. A common one is a share by which all of its numbers are
wrong alike: where some of them are free it holds their mean share, and leaves their ratios to the traces. Where masses
are not free their common share s is carried into the errors: angles are the same when masses, inertias, damping and
forces all grow by s, so that each free number with a mass in its unit is known no better than to s of itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.scene import PriorSpec
from fitting.parameters.naming import full_names
from fitting.parameters.of_scene import find_parameters
from fitting.parameters.parameter import Parameter, resolve


@dataclass(frozen=True)
class Common:
    """A prior of a mean share: `share . values` is 1 with standard deviation `sigma`."""

    share: np.ndarray
    sigma: float


@dataclass(frozen=True)
class JointPrior:
    """What is known of the parameters together.

    Attributes:
        common: priors of several of them.
        carried: standard deviation of the scale of mass, which no trace of angles tells.
        massive: power of mass in every parameter's unit (k,).
        doubt: moves of the parameters (k,) by what could not be told apart, each one standard deviation.
    """

    common: tuple[Common, ...] = ()
    carried: float = 0.0
    massive: np.ndarray | None = None
    doubt: tuple[np.ndarray, ...] = ()

    def carried_covariance(self, values: np.ndarray) -> np.ndarray:
        """Covariance (k, k) of the parameters by what is carried."""
        found = np.zeros((len(values), len(values)))
        if self.massive is not None and self.carried:
            move = self.carried * self.massive * values
            found += np.outer(move, move)
        return found + sum(np.outer(move, move) for move in self.doubt)


def rig_priors(scene: Scene, model: Model, parameters: Sequence[Parameter]) -> tuple[tuple[Parameter, ...], JointPrior]:
    """The parameters with the rig's priors, where the caller gave none, and what is known of them together.

    Raises:
        SceneError: a prior of no number of the scene, or in a unit that is not the number's.
    """
    found, common, carried = list(parameters), [], 0.0
    for i, prior in enumerate([] if scene.fit is None else scene.fit.priors):
        option = f"fit.prior.{i}.of"
        known = _resolve_prior(scene, model, prior.of, option)
        names = {p.name for p in known}
        mine = [j for j, p in enumerate(found) if p.name in names]
        if not prior.common:
            for j in mine:
                if found[j].prior is None:
                    found[j] = replace(found[j], prior=(found[j].value, _width(prior, found[j], f"fit.prior.{i}")))
        elif mine:
            share = np.zeros(len(found))
            share[mine] = [1 / (len(mine) * _nonzero(found[j], option)) for j in mine]
            common.append(Common(share, prior.si[0]))
        elif all(p.unit == "kg" for p in known):
            carried = float(np.hypot(carried, prior.si[0]))
    massive = np.array([float(power_of_mass(p.unit)) for p in found])
    return tuple(found), JointPrior(tuple(common), carried, massive)


def _resolve_prior(scene: Scene, model: Model, of: str, option: str) -> Sequence[Parameter]:
    """The numbers that a prior is of: of the model, else of the scene, such as `sea.current.speed`."""
    name = full_names(scene, [of], option)[0]
    if name.split(".")[0] in ("point", "line", "effects") and scene.written is None:
        return resolve(model, [name], option=option)
    return find_parameters(scene, model, [name], option)


def power_of_mass(unit: str) -> int:
    """1 for a unit that grows with the unit of mass, such as `kg/s` and `N m`; else 0."""
    above = unit.split("/")[0].split()
    return int(any(word.split("^")[0] in ("kg", "N", "Pa", "J") for word in above))


def _width(prior: PriorSpec, p: Parameter, path: str) -> float:
    sigma, unit = prior.si
    if unit == "%":
        return sigma * abs(_nonzero(p, path))
    if unit != p.unit:
        raise SceneError(f"{path}.unit: {prior.unit!r} does not measure {p.name!r}; allowed: {p.unit}, %")
    return sigma


def _nonzero(p: Parameter, path: str) -> float:
    if p.value == 0:
        raise SceneError(f"{path}: {p.name!r} is 0, a share of it is nothing; allowed: sigma in {p.unit}")
    return p.value
