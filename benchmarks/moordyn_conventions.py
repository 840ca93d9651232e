"""Case 4 of the paper, a steady current: what conventions do to the static tension at the anchor."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from moordyn_runs import theirs

from dropper_jax import Scene, load_scene
from dropper_jax.base.fields import component
from dropper_jax.effects.spar_buoys import Around, SparBuoys
from dropper_jax.model import Kinematics
from dropper_jax.run.build import build_model
from dropper_jax.statics.static_pose import equilibrium

#: Anchor tension [N] of MoorDyn v2 at rest. Table 7 has none at rest: its means and largest are of a start.
AT_REST = 1535.2
#: Numbers of links for the chain that reaches above the water.
FINER = (24, 96)


@component
class SurfaceCurrent(SparBuoys):
    """The whole buoy feels the current at the surface."""

    def prepare(self, k: Kinematics) -> Around:
        return _everywhere(self, k, super().prepare(k), surface=True)


@component
class BaseCurrent(SparBuoys):
    """The whole buoy feels the current at its base."""

    def prepare(self, k: Kinematics) -> Around:
        return _everywhere(self, k, super().prepare(k), surface=False)


def _everywhere(buoys: SparBuoys, k: Kinematics, around: Around, surface: bool) -> Around:
    r = k.r[buoys.nodes(k.model)]
    height = jnp.zeros_like(r[:, 2]) if surface else r[:, 2] - buoys.attachment
    u = k.model.sea.at(r.at[:, 2].set(height), k.t).velocity
    return around._replace(velocity=jnp.broadcast_to(u[:, None, :], around.velocity.shape))


def static_tension(scene: Scene, buoys: type[SparBuoys] = SparBuoys) -> float:
    """Static tension at the anchor [N]."""
    model = build_model(scene)
    swapped = tuple(
        buoys(**{f.name: getattr(e, f.name) for f in fields(e)}) if isinstance(e, SparBuoys) else e
        for e in model.effects
    )
    pose = equilibrium(replace(model, effects=swapped))
    return float(pose.tension[0]) if pose.status == "ok" else float("nan")


def _with_links(table: dict[str, Any], links: int) -> Scene:
    """The scene of these plain values with another number of links of the same line."""
    line = dict(table["line"][0])
    share = line["links"] / links
    axial = {**line["axial"], "damping": line["axial"]["damping"] * share}
    line |= {"links": links, "length": line["length"] * share, "mass": line["mass"] * share, "axial": axial}
    effects = {name: {key: _one(value) for key, value in values.items()} for name, values in table["effects"].items()}
    return Scene.from_dict({**table, "line": [line], "effects": effects})


def _one(value: Any) -> Any:
    """One number of a list of equal ones, which then serves any number of links."""
    return value[0] if isinstance(value, list) else value


def conventions() -> list[dict[str, Any]]:
    """Rows of the table, printed as they come."""
    scene = load_scene("paper-case-4")
    on_diameter = np.asarray(scene.effects["morison_drag"]["cdt"]) / np.pi
    centre = scene.with_values({"buoy.0.attachment": 0.5 * scene.buoys[0].height})
    variants = {
        "chain at the base, current over the draught, axial drag on pi D": lambda: static_tension(scene),
        "buoy feels the current at the surface": lambda: static_tension(scene, SurfaceCurrent),
        "buoy feels the current at its base": lambda: static_tension(scene, BaseCurrent),
        "axial drag of the chain on D": lambda: static_tension(
            scene.with_values({"effects.morison_drag.cdt": on_diameter})
        ),
        "chain at half the buoy's height": lambda: static_tension(centre),
    }
    # the point is then above the water: how much of the last link is wet depends on the number of links
    table = centre.to_dict()
    for links in FINER:
        fine = _with_links(table, links)
        variants[f"the same, {links} links"] = lambda fine=fine: static_tension(fine)
    rows = []
    print(f"case 4, static tension at the anchor (MoorDyn v2 at rest: {AT_REST:g} N)")
    for name, tension in variants.items():
        rows.append({"convention": name, "anchor_n": tension()})
        print(f"  {name:64s} {rows[-1]['anchor_n']:8.1f} N  {rows[-1]['anchor_n'] / AT_REST - 1:+.1%}", flush=True)
    last = theirs(scene.with_values({"start.kind": "points"}), 0.0005, 300.0)
    value = float(np.mean(last.mean[-100:, 0])) if last.status == "ok" else float("nan")
    rows.append({"convention": "MoorDyn v2, after 300 s", "anchor_n": value})
    print(f"  {rows[-1]['convention']:64s} {value:8.1f} N  {value / AT_REST - 1:+.1%}", flush=True)
    return rows
