"""An end that follows the waves, such as a platform or a buoy."""

from __future__ import annotations

from dataclasses import field

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import as_array
from dropper_jax.base.read import Values, rises
from dropper_jax.model import Effect, HeldMotion
from dropper_jax.scene import SceneData
from dropper_jax.sea import Sea


@component
class SeaFollowingEnd(HeldMotion):
    """Displacement of a prescribed point by the waves at its mean position: `heave * eta` up, `surge * xi` along each
    wave.

    xi is the horizontal excursion of a particle at the mean surface, `-a (s/w) C(0) sin p`. `heave` and `surge` are
    transfer factors: one number, or values at the frequencies `omega`, linear between. Surge lags the elevation as the
    water itself does. A level of the sea does not move the point.
    """

    name = "sea_following_end"
    needs_sea = True
    heave: Array = parameter("vertical motion over the elevation", unit="-", shape="numbers", default=1.0)
    surge: Array = parameter("horizontal motion over the water's", unit="-", shape="numbers", default=1.0)
    omega: Array | None = parameter("frequencies of the factors", unit="rad/s", shape="table", default=None)
    home: Array = field(kw_only=True)
    ramp_times: Array = field(kw_only=True)  # start and end of the sea's ramp (2,) [s]
    point: str = option("name of the point that moves", type=str, default="")
    also: tuple[str, ...] = option("further points that move with it", type=list, default=())

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        path = "effects.sea_following_end"
        cls.check_points(values, scene)
        if scene.needed_sea.waves is None or scene.needed_sea.ramp is None:
            raise SceneError(f"{path}: needs waves that rise from rest; needed: [sea.waves] and `sea.ramp`")
        omega = values["omega"]
        if omega is not None and not rises(omega):
            raise SceneError(f"{path}.omega: needs at least one number, each above the one before")
        for key in ("heave", "surge"):
            size = np.size(values[key])
            if omega is None and size != 1:
                raise SceneError(f"{path}.{key}: has {size} values, but there is no `omega`; allowed: 1")
            if omega is not None and size not in (1, len(omega)):
                raise SceneError(f"{path}.{key}: has {size} values; allowed: 1, or {len(omega)} as `omega`")

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        home = as_array(scene.point(values["point"]).position)
        return cls(**values, home=home, ramp_times=as_array([0.0, scene.needed_sea.ramp]))

    @property
    def kinks(self) -> Array | None:
        return self.ramp_times

    def _factor(self, value: Array, omega: Array) -> Array:
        """A transfer factor at the frequencies omega (c,)."""
        if jnp.size(value) == 1 or self.omega is None:
            return value
        return jnp.interp(omega, self.omega, value)

    def displace(self, t: Array, sea: Sea) -> Array:
        """Displacement (3,) [m] at time t [s]."""
        waves = sea.waves
        if waves is None:
            return jnp.zeros_like(self.home)
        heave = self._factor(self.heave, waves.omega)
        surge = self._factor(self.surge, waves.omega)
        return waves.excursion(self.home, t, sea.depth, heave, surge)
