"""Drag of water on the links (Morison), split across and along them."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import safe_norm
from dropper_jax.base.read import Values, plain, refuse
from dropper_jax.effects.buoyancy import drag_diameter
from dropper_jax.effects.coefficient_source import SOURCES, check_source
from dropper_jax.effects.drag_velocity import drag_velocity
from dropper_jax.effects.rough_cylinder import steady_drag
from dropper_jax.effects.submerged import split, wet_share
from dropper_jax.model import Effect, Kinematics
from dropper_jax.scene import SceneData


@component
class MorisonDrag(Effect):
    """Drag `F = 1/2 rho L w (Cdn D |u_n| u_n + Cdt pi D |u_t| u_t)` of the water's velocity u relative to the node.

    D is the line's `outer_diameter`, or its `diameter` without one. Axial drag acts on the wetted surface, pi D, as in
    MoorDyn (thesis (6.12) lacks the absolute value, (C.22)-(C.24) the relative velocity: errata). w is the submerged
    fraction. The links' directions are those of the predicted middle of the step, which is second order and keeps the
    force on its own node. `tangents = "implicit"` solves for them too.
    `coefficients` computes cdn per link from the flow of the linear sea, fixed for the run (see
    `modelling.flow_coefficients`).
    `shelter` reduces the current, not the waves, that reaches a link behind others; `wakes` computes it from the lines
    upstream (`modelling.wakes`).

    With frozen and with implicit tangents alike, the force opposes the relative velocity of `drag_velocity`; at an
    instant it never adds energy in water at rest.
    """

    name = "morison_drag"
    needs_water = True
    # read before the run only: roughness, table_kc, table_cdn, table_re and coefficients by run.flow_coefficients,
    # turbulence and wakes by modelling.wakes; `build` leaves them out, and the compiled program does not contain them
    cdn: Array = parameter("drag coefficient across the link", unit="-", shape="link", low=0.0, default=None)
    cdt: Array = parameter("drag coefficient along the link", unit="-", shape="link", low=0.0, default=0.0)
    shelter: Array | None = parameter(
        "factor on the current that reaches the link", unit="-", shape="link", low=0.0, default=None
    )
    roughness: Array | None = parameter(
        "height k of the roughness, for rough_cylinder", unit="m", shape="link", low=0.0, default=None
    )
    table_kc: Array | None = parameter("KC of the table, rising", unit="-", shape="table", low=0.0, default=None)
    table_cdn: Array | None = parameter(
        "drag coefficients of the table at `table_kc`", unit="-", shape="table", low=0.0, default=None
    )
    table_re: Array | None = parameter("minimum and maximum Re of the table", unit="-", shape="table", default=None)
    tangents: str = option("directions of the links", choices=("frozen", "implicit"), default="frozen")
    turbulence: Array | None = parameter(
        "turbulence intensity of the undisturbed current (rms over mean), for wakes",
        unit="-",
        low=0.0,
        high=1.0,
        default=None,
    )
    coefficients: str = option("source of cdn", choices=SOURCES, default="given")
    wakes: str = option("effect of lines on the current behind them", choices=("none", "porous"), default="none")

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        if values["wakes"] != "none":
            _check_wakes(values, scene)
        elif values["turbulence"] is not None:
            raise SceneError("effects.morison_drag.turbulence: is only used with wakes 'porous'")
        check_source("effects.morison_drag", values, "cdn", "drag coefficient across the link")
        sources = {effect.get("coefficients") for effect in (values, scene.effects.get("morison_inertia", {}))}
        if values["roughness"] is not None and "rough_cylinder" not in sources:
            raise refuse(
                "effects.morison_drag.roughness",
                plain(values["roughness"]),
                f"is not used by coefficients {values['coefficients']!r}",
                "with 'rough_cylinder', here or in effects.morison_inertia",
            )

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        """The effect with its coefficients; flow-dependent ones have their steady values until the flow is known."""
        arguments = {key: values[key] for key in ("cdn", "cdt", "shelter", "tangents")}
        if values["coefficients"] == "rough_cylinder":
            arguments["cdn"] = steady_drag(relative_roughness(scene))
        elif values["coefficients"] == "table":
            arguments["cdn"] = np.full(scene.line.links, values["table_cdn"][-1])
        return cls(**arguments)

    @property
    def needs_current(self) -> bool:
        return self.shelter is not None

    @property
    def reach(self) -> int:
        return int(self.tangents == "implicit")

    def _drag_rate(self, k: Kinematics, skin: Array) -> Array:
        """Rate at which drag alone would stop nodes (nodes, 1) [1/s], from the relative speed at the start of the
        step."""
        speed = safe_norm(k.water.motion.velocity - (k.v if k.before is None else k.before))
        coefficient = k.line.node_share(skin * jnp.maximum(self.cdn, jnp.pi * self.cdt))
        return (2.0 * coefficient * speed / k.model.node_mass)[:, None]

    def force(self, k: Kinematics) -> Array:
        water = k.water
        line = k.line
        tangents = water.tangents if self.tangents == "frozen" else k.tangents
        skin = 0.5 * k.sea.density * line.drag_diameter * line.length
        relative = water.motion.velocity - drag_velocity(k, self._drag_rate(k, skin))
        total = jnp.zeros_like(k.v)
        for end in line.link_ends():
            flow = end.at(relative)
            if self.shelter is not None and water.current is not None:
                flow = flow - end.at(water.current) * ((1.0 - self.shelter) * jnp.ones_like(skin))[:, None]
            across, along = split(flow, tangents)
            wet = end.share * wet_share(k, end, tangents, water.motion.elevation)
            normal = (wet * (skin * self.cdn) * safe_norm(across))[:, None] * across
            axial = (wet * (jnp.pi * skin * self.cdt) * safe_norm(along))[:, None] * along
            total = total + end.collect(normal + axial)
        return total


def _check_wakes(values: Values, scene: SceneData) -> None:
    """Reject wakes without a current, or with one that reverses, and fixed factors next to them."""
    path = "effects.morison_drag.wakes: 'porous'"
    if scene.sea is None or scene.sea.current is None:
        raise SceneError(f"{path} needs a current. Use a scene with [sea.current]")
    if values["shelter"] is not None:
        raise SceneError(f"{path} cannot be combined with shelter, which it replaces; allowed: one of the two")
    current = scene.sea.current
    factor = 1.0 if current.factor is None else current.factor
    if current.amplitude is not None or np.min(factor) < 0 < np.max(factor):
        raise SceneError(
            f"{path} needs one direction of the current, but the current reverses here; "
            "allowed: a steady current, or factors of one sign"
        )


def relative_roughness(scene: SceneData) -> np.ndarray:
    """k/D of each link (n,); smooth if no roughness is given."""
    height = scene.effects.get("morison_drag", {}).get("roughness")
    return (0.0 if height is None else height) / drag_diameter(scene) * np.ones(scene.line.links)
