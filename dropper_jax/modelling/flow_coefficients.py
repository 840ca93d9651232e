"""Flow-dependent drag and added mass: KC and Re of each link in the linear sea, constant during the run.

At the middle of each link in the equilibrium in calm water (with the current), with the water velocity normal to it

    sigma = rms of the waves' part,  T_z = 2 pi sqrt(m0/m2) of the sea (of a regular one its period),
    KC = sqrt(2) sigma T_z/D,   Re = sqrt(U^2 + sigma^2) D/nu,   share of the current = U/(U + sqrt(2) sigma)

The motion of the line is left out: KC is that of a line at rest.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.constants import VISCOSITY
from dropper_jax.base.numerics import spread, unit_vectors
from dropper_jax.base.read import Table
from dropper_jax.effects.buoyancy import drag_diameter
from dropper_jax.effects.coefficient_source import from_table
from dropper_jax.effects.morison_drag import relative_roughness
from dropper_jax.effects.rough_cylinder import POST_CRITICAL, rough_added_mass, rough_drag
from dropper_jax.load.scene import Scene
from dropper_jax.load.sea_warnings import mean_period
from dropper_jax.modelling.scene_model import bare_model, resting_nodes
from dropper_jax.scene import line_slices
from dropper_jax.scene.slices import first_nodes
from dropper_jax.sea import Sea

#: Effects whose coefficients may depend on the flow, and these coefficients.
FOLLOWING = {"morison_drag": "cdn", "morison_inertia": "can"}


@dataclasses.dataclass(frozen=True)
class Flow:
    """Flow normal to each link (n,): KC (infinite without waves), Re, fraction of the current; resulting C_D and
    C_A."""

    kc: np.ndarray
    re: np.ndarray
    current: np.ndarray
    coefficients: dict[str, np.ndarray]


def flow_dependent_effects(scene: Scene) -> list[str]:
    """The effects of a scene whose coefficients depend on the flow."""
    return [name for name in FOLLOWING if scene.effects.get(name, {}).get("coefficients", "given") != "given"]


def with_flow_coefficients(scene: Scene) -> Scene:
    """The scene with flow-dependent coefficients replaced by numbers; other scenes are unchanged."""
    if not flow_dependent_effects(scene):
        return scene
    found = {}
    for name, values in link_flow(scene).coefficients.items():
        found[name] = {**scene.effects[name], FOLLOWING[name]: values, "coefficients": "given"}
    return dataclasses.replace(scene, effects={**scene.effects, **found})


def link_flow(scene: Scene) -> Flow:
    """Flow and coefficients of a scene's links, mussels included as they are in its lines.

    Raises:
        SceneError: KC or Re outside of a table.
    """
    model = bare_model(scene, "float64")
    nodes = resting_nodes(scene, model)
    first = first_nodes(scene)
    tangent = unit_vectors(nodes[first + 1] - nodes[first])
    diameter = drag_diameter(scene) * np.ones(len(tangent))
    sea = model.needed_sea
    middle = 0.5 * (nodes[first] + nodes[first + 1])
    current = np.zeros(len(tangent))
    if sea.current is not None:
        steady = np.asarray(sea.current.profile(jnp.asarray(middle[:, 2]), jnp.asarray(sea.depth)))
        current = np.linalg.norm(_across(steady, tangent), axis=1)
    sigma = np.zeros(len(tangent))
    kc = np.full(len(tangent), np.inf)
    if sea.waves is not None:
        sigma = _wave_speed(sea, middle[:, 2], tangent)
        period = mean_period(sea)
        if sea.waves.size == 1 or sea.waves.bound:
            period = float(2 * np.pi / sea.waves.omega[0])
        kc = np.sqrt(2.0) * sigma * period / diameter
    re = np.sqrt(current**2 + sigma**2) * diameter / VISCOSITY
    share = current / np.maximum(current + np.sqrt(2.0) * sigma, 1e-12)
    rough = relative_roughness(scene)
    found = {}
    for name in flow_dependent_effects(scene):
        values = scene.effects[name]
        key = FOLLOWING[name]
        if values["coefficients"] == "table":
            found[name] = from_table(f"effects.{name}", kc, re, values, f"table_{key}")
        elif key == "cdn":
            found[name] = rough_drag(kc, rough, share)
        else:
            found[name] = rough_added_mass(kc, rough)
    return Flow(kc, re, share, found)


def _across(velocity: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """The part of velocities (..., 3) across links with these tangents."""
    return velocity - np.sum(velocity * tangent, axis=-1, keepdims=True) * tangent


def _wave_speed(sea: Sea, z: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """RMS (n,) [m/s] of the waves' velocity across links at heights z [m]."""
    waves = sea.waves
    profiles = waves.profiles(jnp.minimum(jnp.asarray(z), 0.0), jnp.asarray(sea.depth))
    horizontal, vertical = np.stack(profiles) * np.asarray(waves.speeds)
    course = np.asarray(waves.direction) * np.ones(waves.size)
    # velocity of a component: horizontal part as the cosine, vertical part as the sine of its phase
    zero = np.zeros_like(vertical)
    cosine = np.stack([horizontal * np.cos(course), horizontal * np.sin(course), zero], axis=-1)
    sine = np.stack([zero, zero, vertical], axis=-1)
    across = _across(np.stack([cosine, sine]), tangent[:, None])
    return np.sqrt(0.5 * np.sum(across**2, axis=(0, 2, 3)))


def flow_table(scene: Scene) -> list[Table]:
    """Per line of a scene: minimum and maximum of KC, Re and the coefficients, the fraction of the current, and
    violated assumptions."""
    flow = link_flow(scene)
    each = {"keulegan_carpenter": flow.kc, "reynolds": flow.re, "current_share": flow.current}
    each |= {FOLLOWING[name]: values for name, values in flow.coefficients.items()}
    found = []
    for line in line_slices(scene):
        row: Table = {"line": line.name}
        for key, values in each.items():
            row[key] = spread(values[line.links], ("min", "max"))
        row["post_critical"] = bool(np.all(flow.re[line.links] >= POST_CRITICAL))
        found.append(row)
    return found


def flow_cells(rows: list[Table]) -> list[tuple[str, ...]]:
    """Rows of `flow_table` as text, with a heading."""
    coefficients = [key for key in ("cdn", "can") if key in rows[0]]
    keys = ("keulegan_carpenter", "reynolds", "current_share", *coefficients)
    found: list[tuple[str, ...]] = [("line", "KC", "Re", "share of the current", *coefficients)]
    for row in rows:
        found.append((row["line"], *(f"{row[key]['min']:.3g} to {row[key]['max']:.3g}" for key in keys)))
    return found
