"""The way back of a run, against differences of runs by `integrate`."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from dropper_jax import SceneError, build, build_model, integrate, load_scene, make_stepper
from dropper_jax.stepping.adjoint import backward_pass, check_recordable, record

STEPS, H = 24, 0.05


@pytest.fixture(scope="module")
def farm():
    """One loop between two legs, in waves: model, start, stepper. Damped, so that slack links do not chatter."""
    scene = load_scene("looped-longline").with_values(
        {"parameters.loops": 1, "parameters.loop_links": 2, "parameters.leg": 62.0}
        | {f"line_type.{name}.law": "damped_rope" for name in ("backbone", "leg", "sock")}
        | {f"line_type.{name}.damping_ratio": 1.0 for name in ("backbone", "leg", "sock")}
    )
    table = scene.to_dict()
    table["sea"] |= {"waves": {"kind": "regular", "amplitude": 1.5, "period": 8.0}}
    scene = load_scene(table)
    model, start = build(scene)
    return model, start, make_stepper(model, halvings=0, track_work=False)


def quantities(r, tension):
    """Two numbers of a run: of all tensions, and of the last heights."""
    return jnp.stack([jnp.sum(tension**2) * 1e-8, jnp.sum(r[-5:, :, 2] ** 3) * 1e-3])


@pytest.fixture(scope="module")
def way(farm):
    """A way back by lengths and masses of links and by the start; the run as a function of these."""
    model, start, stepper = farm
    leaves, tree = jax.tree.flatten(model)
    moving = tuple(i for i, leaf in enumerate(leaves) if leaf is model.line.length or leaf is model.line.mass)
    assert len(moving) == 2

    @jax.jit
    def both_ways(start):
        run = record(stepper, model, start, H, STEPS)
        by_r, by_t = (jnp.moveaxis(a, 0, 1) for a in jax.jacrev(quantities, argnums=(0, 1))(run.r, run.tension))
        return run, backward_pass(stepper, model, moving, run, H, by_r, by_t)

    # from the midst of a motion: at rest slack links are at the length where they tauten
    start = replace(start, work=jnp.zeros(0))  # no ledger, as in the states of the run: one program for both
    start = jax.tree.map(lambda a: a[-1], both_ways(start)[0].before)

    def values(chosen, r):
        changed = list(leaves)
        for i, leaf in zip(moving, chosen, strict=True):
            changed[i] = leaf
        found = integrate(stepper, jax.tree.unflatten(tree, changed), replace(start, r=r), H, STEPS)[1]
        return quantities(found.r, found.tension)

    run, (by_leaf, by_start) = both_ways(start)
    return [leaves[i] for i in moving], start, run, by_leaf, by_start, values


@pytest.mark.check
def test_the_way_back_is_that_of_automatic_differentiation(way):
    """Along twelve random directions through all lengths, masses and positions at once; relative to their scale."""
    chosen, start, run, by_leaf, by_start, values = way
    flat, unravel = ravel_pytree((chosen, start.r))
    along = np.random.default_rng(1).normal(size=(12, len(flat))) * np.abs(flat)
    found, slopes = jax.jit(
        lambda x, along: jax.lax.map(lambda d: jax.jvp(lambda x: values(*unravel(x)), (x,), (d,)), along)
    )(flat, along)
    np.testing.assert_allclose(quantities(run.r, run.tension), found[0], rtol=1e-10)
    rows = jnp.stack([ravel_pytree((([a[q] for a in by_leaf]), by_start.r[q]))[0] for q in range(2)])
    scale = np.sqrt(rows**2 @ (along**2).T).T  # of sums of independent terms
    np.testing.assert_allclose((along @ rows.T) / scale, slopes / scale, rtol=0, atol=1e-8)


@pytest.mark.check
def test_a_way_back_in_two_parts_is_that_of_the_whole(farm, way):
    model, _, stepper = farm
    chosen, start, run, by_leaf, by_start, _ = way
    leaves, half = jax.tree.leaves(model), STEPS // 2
    moving = tuple(i for i, leaf in enumerate(leaves) if any(leaf is own for own in chosen))
    by_r, by_t = (jnp.moveaxis(a, 0, 1) for a in jax.jacrev(quantities, argnums=(0, 1))(run.r, run.tension))
    first = record(stepper, model, start, H, half)
    second = record(stepper, model, first.last, H, STEPS - half)
    late, between = backward_pass(stepper, model, moving, second, H, by_r[half:], by_t[half:])
    early, begin = backward_pass(stepper, model, moving, first, H, by_r[:half], by_t[:half], between)
    for one, other, whole in zip(late, early, by_leaf, strict=True):
        np.testing.assert_allclose(one + other, whole, rtol=1e-9, atol=1e-11 * np.max(np.abs(whole)))
    np.testing.assert_allclose(begin.r, by_start.r, rtol=1e-9, atol=1e-11 * np.max(np.abs(by_start.r)))


def test_what_has_no_way_back_is_refused():
    model = build_model(load_scene("dropper-release-a"))
    with pytest.raises(SceneError, match="a single line; allowed: systems of lines"):
        check_recordable(make_stepper(model), model)
    model = build_model(load_scene("looped-longline").with_values({"parameters.loops": 1}))
    with pytest.raises(SceneError, match="'rk4' has no backward pass; allowed: energy_momentum"):
        check_recordable(make_stepper(model, "rk4"), model)
