"""Longlines that move: energy, gradients."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax import build, build_model, equilibrium, integrate, load_scene, make_stepper, settle, simulate

FLOW = {"cdn": 1.4, "cdt": 0.2, "can": 1.0, "cat": 1.0}


@pytest.mark.check
@pytest.mark.parametrize("law", ["rope", "damped_rope"])
def test_a_falling_chain_in_water_at_rest_never_gains_energy(one_line, law):
    kind = {"law": law, "mass": 10.91, "diameter": 0.042, "EA": 1e6, "damping_ratio": 0.05} | FLOW
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}, "seabed": {"depth": 12.0}}
    scene = one_line(16.0, 8, [0.0, 0.0, -2.0], [8.0, 0.0, -2.0], kind, effects, sea={"depth": 12.0})
    scene["point"][1] = {"name": "b", "kind": "free", "position": [8.0, 0.0, -2.0], "mass": 20.0, "volume": 0.01}
    scene["start"] = {"kind": "points"}
    solution = simulate(scene, dt=0.02, duration=12.0)
    assert solution.status == "ok", solution.failure
    work = dict(zip(solution.work_names, solution.work.T, strict=True))
    for name in ("morison_drag", "internal_damping"):
        assert np.max(np.diff(work[name])) <= 1e-9 * solution.energy_scale, name
    # the ringing force stores and returns energy of vibrations that the step does not resolve, and takes it in the end
    ringing = work["axial_ringing"]
    assert np.max(ringing - np.minimum.accumulate(ringing)) < 1e-3 * solution.energy_scale
    assert ringing[-1] < 0.0
    assert solution.energy_drift < 1e-6 * solution.energy_scale


def driven_chain(one_line):
    """A chain that hangs free of the bed, taut, its top driven in a current."""
    kind = {"mass": 10.91, "diameter": 0.042, "EA": 1e5, "damping_ratio": 0.1} | FLOW
    motion = {"point": "b", "amplitude": [0.3, 0.0, 0.1], "period": 4.0, "ramp": 1.0}
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}, "end_motion": motion}
    sea = {"depth": 20.0, "current": {"kind": "uniform", "speed": 0.5, "direction": 1.0}}
    scene = one_line(24.0, 4, [0.0, 0.0, -10.0], [20.0, 0.0, 0.0], kind, effects, sea=sea)
    model, s = build(scene)
    return model, s, make_stepper(model).plain


def scaled(model, factors):
    """The model with axial stiffness, drag coefficient, mass and length scaled."""
    line, drag = model.line, model.effect("morison_drag")
    axial = replace(line.axial, EA=line.axial.EA * factors[0])
    line = replace(line, axial=axial, mass=line.mass * factors[2], length=line.length * factors[3])
    drag = replace(drag, cdn=drag.cdn * factors[1])
    effects = tuple(drag if e.name == drag.name else e for e in model.effects)
    return replace(model, lines=(line,), effects=effects)


def assert_differences_agree(value, slopes, size=1e-5):
    """To 1e-5, or to what values known to 2e-12 leave of a difference."""
    known = 2e-12 * abs(float(value(jnp.ones(len(slopes))))) / size
    for i, slope in enumerate(slopes):
        ahead = jnp.ones(len(slopes)).at[i].add(size)
        behind = jnp.ones(len(slopes)).at[i].add(-size)
        assert float((value(ahead) - value(behind)) / (2 * size)) == pytest.approx(float(slope), rel=1e-5, abs=known), i


@pytest.mark.check
def test_gradients_of_the_mean_tension_of_a_driven_chain_agree_with_differences(one_line, both_modes):
    model, s, stepper = driven_chain(one_line)

    def mean_tension(factors):
        return jnp.mean(integrate(stepper, scaled(model, factors), s, 0.02, 100)[1].tension)

    run = both_modes(mean_tension)
    _, reverse, forward = run(jnp.ones(4))
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    # curvature jumps where a damper begins to pull, so that differences come near with their size, not with its square
    assert_differences_agree(lambda x: run(x)[0], forward, size=1e-7)


@pytest.mark.check
def test_gradients_of_the_static_anchor_tension_of_case_4_agree_with_differences():
    scene = load_scene("paper-case-4")
    model, near = build_model(scene), equilibrium(scene).state

    @jax.jit
    def anchor(factors):
        return settle(scaled(model, factors), near).tension[0]

    assert float(anchor(jnp.ones(4))) == pytest.approx(1535.2, rel=0.005)  # MoorDyn v2 after 300 s
    assert_differences_agree(anchor, jax.jit(jax.jacfwd(anchor))(jnp.ones(4)))
