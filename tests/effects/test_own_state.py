"""Effects that a run changes: creep against its closed form, through halving, derivatives, batches and files."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import hung_line

import dropper_jax as dj
from dropper_jax import Effect, build_model, component, parameter, register
from dropper_jax.effects import EFFECTS

MASS, LENGTH, GRAVITY, EA = 1.0, 2.0, 9.81, 1.0e5
#: Slow beside the mass: what accelerates it changes the strain by `m L E2/eta^2` of it, 1e-4.
SPRING, VISCOSITY = 5.0e3, 1.0e4
END = 2.0


@component
class Creep(Effect):
    """Links lengthen under load, as a rope does in weeks: `T = EA (e - c)`, `eta c' = T - E2 c`."""

    name = "creep"
    reach = 1
    spring: jax.Array = parameter("stiffness E2 that stops it", unit="N", low=0.0)
    viscosity: jax.Array = parameter("viscosity eta", unit="N s", above=0.0)
    strain: jax.Array | None = None

    def begin(self, model):
        return jnp.zeros_like(model.line.length)

    def entered(self, own):
        return replace(self, strain=own)

    def force(self, k):
        return -k.model.geometry.gather((k.line.axial.EA * self.strain)[:, None] * k.tangents)

    def advance(self, before, after, tension, h):
        pull = tension - after.line.axial.EA * self.strain
        return self.strain + h * (pull - self.spring * self.strain) / self.viscosity


@pytest.fixture
def known():
    """The effect known to scenes, for the length of a test."""
    register(Creep)
    yield
    del EFFECTS["creep"]


def rope(dt=0.002, links=1):
    """A mass on a rope that hangs at rest, as stretched as it is without creep."""
    each = LENGTH / links
    stretched = [0.0, *np.cumsum(each * (1 + MASS * (links - np.arange(links)) * GRAVITY / EA))]
    return hung_line(links, each, MASS, axial={"law": "elastic", "EA": EA, "damping": 500.0}) | {
        "run": {"dt": dt, "duration": END},
        "effects": {"weight": {"gravity": GRAVITY}, "creep": {"spring": SPRING, "viscosity": VISCOSITY}},
        "start": {"kind": "positions", "positions": [[0.0, 0.0, -z] for z in stretched]},
    }


def closed_form(t):
    """Creep strain under the weight alone."""
    return MASS * GRAVITY / SPRING * (1.0 - np.exp(-SPRING * t / VISCOSITY))


@pytest.mark.slow
def test_creep_follows_its_closed_form_in_first_order(known):
    errors = []
    for dt in (0.02, 0.01):
        solution = dj.simulate(rope(dt))
        assert solution.status == "ok"
        errors.append(np.max(np.abs(solution.own["creep"][:, 0] - closed_form(solution.t))))
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    fine = dj.simulate(rope(0.001))
    assert fine.own["creep"][:, 0] == pytest.approx(closed_form(fine.t), abs=1e-3 * closed_form(END))
    longer = -fine.positions[-1, -1, 2] - LENGTH * (1 + MASS * GRAVITY / EA)
    assert longer == pytest.approx(LENGTH * closed_form(END), rel=5e-3)


@pytest.mark.parametrize("integrator", ["energy_momentum", "generalized_alpha", "rk4", "semi_implicit_euler"])
def test_every_kind_of_scheme_carries_it(known, integrator):
    run = {"integrator": integrator, "duration": 0.2}
    solution = dj.simulate(rope() | {"run": {"dt": 0.0005} | run})
    assert solution.own["creep"][-1, 0] == pytest.approx(closed_form(0.2), rel=5e-3)


@pytest.mark.check
def test_a_divided_step_advances_it_by_parts(known):
    model, s = dj.build(rope(links=2))
    s = replace(s, v=s.v.at[-1, 0].set(3.0), own={"creep": jnp.array([1e-3, 2e-3])})
    # no step is good enough: a quarter of the interval is taken as it is, then the rest in steps of up to twice as much
    never = dj.make_stepper(model, tolerance=0.0, halvings=2)
    exact = dj.make_stepper(model)
    h = jnp.asarray(0.02)
    halved, run = dj.integrate(never, model, s, h, 1)
    assert int(run.retried[0]) == 1
    parts = s
    for part in (0.25, 0.375, 0.375):
        parts, _ = dj.step(exact, model, parts, part * h)
    np.testing.assert_allclose(halved.own["creep"], parts.own["creep"], rtol=1e-9)
    whole, _ = dj.step(exact, model, s, h)
    assert np.max(np.abs(whole.own["creep"] - halved.own["creep"])) > 1e-9


@pytest.mark.check
@pytest.mark.parametrize("checkpoint", [False, True])
def test_derivatives_and_batches_go_through_it(known, checkpoint, both_modes):
    model, start = dj.build(rope())
    stepper = dj.make_stepper(model).plain

    def length(viscosity):
        weight, creep = model.effects
        softer = replace(model, effects=(weight, replace(creep, viscosity=viscosity)))
        last, _ = dj.integrate(stepper, softer, start, dt=0.01, steps=20, checkpoint=checkpoint)
        return -last.r[-1, 2]

    _, (reverse,), (forward,) = both_modes(length)(jnp.asarray(VISCOSITY))
    step = 1e-3 * VISCOSITY
    batch = np.asarray(jax.jit(jax.vmap(length))(jnp.array([VISCOSITY - step, VISCOSITY + step])))
    assert float(reverse) == pytest.approx((batch[1] - batch[0]) / (2 * step), rel=1e-5)
    assert float(forward) == pytest.approx(float(reverse), rel=1e-9)
    assert reverse < 0.0


@pytest.mark.parametrize("suffix", [".npz", ".nc"])
def test_files_keep_it(known, tmp_path, suffix):
    solution = dj.simulate(rope(0.01), duration=0.1)
    again = dj.Solution.load(solution.save(tmp_path / f"run{suffix}"))
    np.testing.assert_array_equal(again.own["creep"], solution.own["creep"])


def test_a_scene_without_such_effects_carries_nothing():
    assert dj.build("string")[1].own == {}


def test_nodes_are_found_through_their_line():
    chain = build_model(dj.load_scene("string"))
    k = chain.kinematics(jnp.zeros((chain.free_nodes, 3)), jnp.zeros((chain.free_nodes, 3)), 0.0)
    assert k.node(0, 1) == k.node(chain.line.name, 1) == 0
    system = build_model(dj.load_scene("paper-case-1"))  # without its static pose
    for i, member in enumerate(system.geometry.members):
        inner = system.geometry.node(member.name, 1)
        assert inner == system.geometry.node(i, 1) == system.geometry.paths[i][1]
    for model, line, node, message in (
        (system, "nowhere", 1, "line: 'nowhere' is unknown"),
        (chain, 0, 0, "node: 0 of line 0 is fixed"),
        (chain, 0, 99, "allowed: 0 to"),
    ):
        with pytest.raises(ValueError, match=message):
            model.geometry.node(line, node)
