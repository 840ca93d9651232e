"""Static release poses against the measured ones: fit the force at the lifted node, print the misfits side by side.

    python benchmarks/static_validation.py

For each scenario of the lab experiment the two components of the force at the lifted node are fitted to the mean link
angles of the measured runs, with equivalent simple links (either order of the two kinds) and with the compound bars.
The table is Markdown, for the README.
"""

import csv
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares
from study import command, show

import dropper_jax as dj
from dropper_jax.statics.static_pose import equilibrium, nodal_loads

LIFTED = {"A": 1, "B": 2, "C": 3}
KINDS = {"simple links, A first": "a first", "simple links, B first": "b first", "compound bars": "compound"}


def measured() -> dict[str, dict[str, np.ndarray]]:
    """Mean of the runs and the thesis' model column, by scenario, theta > 0 for a link that goes down as x grows."""
    text = (resources.files("dropper_jax") / "data" / "release_angles_rad.csv").read_text()
    rows: dict[str, dict[str, list[float]]] = {}
    for row in csv.DictReader(text.splitlines()):
        sign = 1.0 if row["scenario"] == "A" else -1.0  # B and C are printed with the opposite sign
        angles = [sign * float(row[f"theta_{i}"]) for i in range(1, 8)]
        rows.setdefault(row["scenario"], {})[row["column"]] = angles
    return {
        scenario: {
            "mean": np.mean([np.array(v) for k, v in columns.items() if k.startswith("run")], axis=0),
            "model": np.array(columns["model"]),
        }
        for scenario, columns in rows.items()
    }


def model_of(kind: str) -> dj.Model:
    """The lab dropper with one kind of links."""
    if kind == "compound":
        return dj.build("dropper-release-a-compound")[0]
    scene = dj.load_scene("dropper-release-a")
    if kind == "a first":
        line = scene.lines[0]
        swapped = {"line.0.length": line.length[[1, 0] * 3 + [1]], "line.0.mass": line.mass[[1, 0] * 3 + [1]]}
        scene = scene.with_values(swapped)
    return dj.build(scene)[0]


def planar_angles(model: dj.Model, r: jax.Array) -> jax.Array:
    """Angles of the links below the horizontal (n,) [rad] in the x-z plane."""
    d = model.links(r, model.ends(jnp.zeros(())))
    return jnp.arctan2(-d[:, 2], d[:, 0])


def fit_force(model: dj.Model, node: int, target: np.ndarray) -> tuple[np.ndarray, float]:
    """Force (fx, fz) [N] at `node` whose pose is nearest to the target angles, and the RMS misfit [rad].

    The Jacobian is exact (the pose's derivative by the implicit function theorem). A direction of the force that
    turns nothing is left where it is.
    """

    def misfit(force: np.ndarray) -> np.ndarray:
        pose = equilibrium(model, nodal_loads(model, [node], [[force[0], 0.0, force[1]]]))
        return np.asarray(planar_angles(model, pose.state.r)) - target

    @jax.jit
    def slope(force: jax.Array, near: dj.State) -> jax.Array:
        def angles(f: jax.Array) -> jax.Array:
            loads = jnp.zeros((model.free_nodes, 3)).at[node - 1].set(jnp.array([f[0], 0.0, f[1]]))
            return planar_angles(model, dj.settle(model, near, loads).r)

        return jax.jacfwd(angles)(force)

    def jacobian(force: np.ndarray) -> np.ndarray:
        pose = equilibrium(model, nodal_loads(model, [node], [[force[0], 0.0, force[1]]]))
        return np.asarray(slope(jnp.asarray(force), pose.state))

    found = least_squares(misfit, np.array([0.0, 0.9]), jac=jacobian, x_scale=0.1, xtol=1e-12, ftol=1e-12)
    return found.x, float(np.sqrt(np.mean(found.fun**2)))


@command()
def main() -> None:
    show("links", *LIFTED, "thesis' model column of A")
    targets = measured()
    cases = [(node, targets[scenario]["mean"]) for scenario, node in LIFTED.items()] + [(1, targets["A"]["model"])]
    for label, kind in KINDS.items():
        model = model_of(kind)
        show(label, *(f"{fit_force(model, node, target)[1]:.4f}" for node, target in cases))
