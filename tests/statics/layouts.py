"""Random longlines at rest: whether a static pose is found, balances and is stable.

Layout i is drawn from seed i: a topology, a bed (flat, sloping, with hills), ropes and chains from floating to heavy,
lengths from taut to slack, floats and spar buoys from too small to much too large, depths of 5 to 60 m, currents of 0
to 2 m/s.

- Balance: forces of the effects and `EA max(e, 0)` of every link, summed independently in NumPy, over the weight of
  all lines.
- Stability: smallest real part of the eigenvalues of the whole stiffness, drag included (a pose to which every slow
  motion returns), over the weight of a mean link per its length. What nothing holds has zero.
"""

import jax.numpy as jnp
import numpy as np
from layout_draws import Scene, layout

import dropper_jax as dj
from dropper_jax.statics import rest
from dropper_jax.statics.host_stiffness import stiffness

#: Largest unbalanced force of a pose that counts as found, and its most negative stiffness.
BALANCED = 1e-8
STABLE = -1e-6


def unbalanced(model: dj.Model, s: dj.State) -> np.ndarray:
    """Forces that are left on the free nodes (free, 3) [N], with tensions from the positions of the ropes' ends."""
    graph, line = model.geometry, model.line
    nodes = np.concatenate([s.r, model.ends(s.t).positions])
    d = nodes[graph.last] - nodes[graph.first]
    now = np.linalg.norm(d, axis=1)
    pull = line.axial.EA * np.maximum(now / line.length - 1.0, 0.0) / now
    total = np.zeros_like(nodes)
    np.add.at(total, graph.first, pull[:, None] * d)
    np.add.at(total, graph.last, -pull[:, None] * d)
    return total[: graph.free] + model.force(model.instant(s.r, jnp.zeros_like(s.r), s.t))


def judged(seed: int) -> Scene:
    """Layout `seed` solved: what `dj.equilibrium` says, balance and stability of the pose."""
    found: Scene = {"seed": seed, "name": layout(seed)["name"]}
    try:
        scene = dj.load_scene(layout(seed))
        pose = dj.equilibrium(scene)
    except dj.SceneError as error:
        return found | {"ok": False, "why": f"refused: {error}"}
    model, s = rest(dj.build_model(scene)), pose.state
    weight = 9.81 * np.asarray(model.line.mass)
    values = np.linalg.eigvals(stiffness(model, s, jnp.zeros_like(s.r)).toarray())
    found |= {
        "residual": float(np.max(np.abs(unbalanced(model, s))) / np.sum(weight)),
        "stiffness": float(np.min(values.real) / np.mean(weight) * np.mean(model.line.length)),
    }
    reasons = {
        pose.message: pose.status != "ok",
        "out of balance": not found["residual"] <= BALANCED,
        "not stable": not found["stiffness"] >= STABLE,
    }
    return found | {"ok": not any(reasons.values()), "why": "; ".join(why for why, bad in reasons.items() if bad)}
