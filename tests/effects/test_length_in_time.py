"""Links whose unstretched length changes in time: a mass on a spring against SciPy, energy, derivatives, winches."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax.effects.changing_links import WinchState
from dropper_jax.model import work_names
from dropper_jax.stepping.observe import observe

MASS = 20.0  # [kg]
EA = 4000.0  # [N]
BA = 150.0  # [N s]
LENGTH = 5.0  # [m]
GRAVITY = 9.81
DURATION = 4.0  # [s]
TIME = [0.0, 0.5, 1.5, 3.0, 4.0]  # [s]
TABLE = [5.0, 5.0, 3.8, 4.4, 4.4]  # [m]


def scene(changing, dt=0.01, law="elastic", links=1, **run):
    """A mass on a vertical line that starts at rest in its equilibrium."""
    axial = {"law": law}
    if law != "rigid":
        axial |= {"EA": EA, "damping": BA}
    rope = line_of(
        "rope", "drum", "mass", links, LENGTH / links, mass=MASS / links, axial=axial, length_in_time=changing
    )
    points = [fixed("drum", 0.0, 0.0, 0.0), free("mass", 0.0, 0.0, -LENGTH)]
    run = {"dt": dt, "duration": DURATION, **run}
    return system(points, [rope], name="mass on a winch", run=run, start={"kind": "static"})


def table(**more):
    return [{"end": "from", "time": TIME, "length": TABLE, **more}]


def with_entry(model, entry):
    """The model with another entry of its only effect of this kind."""
    effects = (replace(e, entries=(entry,)) if e.name == "length_in_time" else e for e in model.effects)
    return replace(model, effects=tuple(effects))


def entry_of(model, **changes):
    """The entry of a model's only effect of this kind, with other values."""
    return replace(model.effect("length_in_time").entries[0], **changes)


def by_scipy(length, times, breaks=()):
    """Position below the drum (k,) [m], tension (k,) [N], and energy of the drum (k,) [J] by DOP853."""

    def tension(t, x, v):
        now, rate = length(t)
        return EA * (x - now) / now + BA * (v - rate) / now

    def slope(t, y):
        x, v, _ = y
        now, rate = length(t)
        pull = tension(t, x, v)
        strain = (x - now) / now
        return [v, GRAVITY - pull / MASS, -(pull + 0.5 * EA * strain**2) * rate]

    start = length(0.0)[0]
    state = np.array([start * (1.0 + MASS * GRAVITY / EA), 0.0, 0.0])
    found = []
    ends = np.unique([0.0, *breaks, times[-1]])
    for a, b in zip(ends[:-1], ends[1:], strict=True):
        inside = times[(times > a) & (times <= b)]
        inner = lambda t, y, a=a, b=b: slope(np.clip(t, a + 1e-12, b - 1e-12), y)  # noqa: E731
        exact = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
        ran = solve_ivp(inner, (a, b), state, t_eval=np.unique([*inside, b]), **exact)
        found += list(ran.y.T[np.isin(ran.t, inside)])
        state = ran.y[:, -1]
    return np.array(found).T


def linear(t):
    i = int(np.clip(np.searchsorted(TIME, t, side="right") - 1, 0, len(TIME) - 2))
    return np.interp(t, TIME, TABLE), (TABLE[i + 1] - TABLE[i]) / (TIME[i + 1] - TIME[i])


def smooth(t, end=3.8):
    """From 5 m to `end` and back over 4 s."""
    half = 0.5 * (LENGTH - end)
    return LENGTH - half * (1.0 - np.cos(0.5 * np.pi * t)), -half * 0.5 * np.pi * np.sin(0.5 * np.pi * t)


def smooth_by_jax(t, end):
    return LENGTH - 0.5 * (LENGTH - end) * (1.0 - jnp.cos(0.5 * jnp.pi * t))


def run_of(model, start, integrator, count):
    stepper = dj.make_stepper(model, integrator)
    ran = jax.jit(lambda s, h: dj.integrate(stepper, model, s, h, count, count // 100)[1])
    return ran(start, DURATION / count)


def differences(model, run, length, breaks=()):
    """Errors against SciPy: of the position, over 5 m; of the work of the drum, over its maximum."""
    times = DURATION * np.arange(1, 101) / 100
    x, _, drum = by_scipy(length, times, breaks)
    booked = np.asarray(run.work)[:, work_names(model).index("length_in_time")]
    position = np.max(np.abs(-np.asarray(run.r)[:, 0, 2] - x)) / LENGTH
    return position, np.max(np.abs(booked - drum)) / np.max(np.abs(drum))


@pytest.mark.check
def test_mass_on_a_spring_of_changing_length_agrees_with_dop853_to_second_order():
    model, start = dj.build(scene(table()))
    runs = (run_of(model, start, "energy_momentum", count) for count in (400, 800, 3200))
    errors = np.array([differences(model, run, linear, TIME) for run in runs])
    orders = np.log(errors[:-1] / errors[1:]) / np.log([[2.0], [4.0]])
    assert np.all(np.abs(orders - 2.0) < 0.05)
    assert errors[-1, 0] < 1e-6
    assert errors[-1, 1] < 1e-5


def test_runge_kutta_follows_a_smooth_function_of_time():
    plain, _ = dj.build(scene([], integrator="rk4"))
    model = dj.with_length_in_time(plain, smooth_by_jax, 3.8, end="from")
    start = dj.state(model, dj.equilibrium(model).state.r)
    position, drum = differences(model, run_of(model, start, "rk4", 400), smooth)
    assert position < 1e-7
    assert drum < 1e-6


@pytest.mark.parametrize("law", ["elastic", "rope", "damped_rope"])
def test_energy_balance_closes_to_rounding(law):
    solution = dj.simulate(scene(table(links=3), law=law, links=3))
    assert solution.status == "ok"
    total = solution.kinetic + solution.potential - np.sum(solution.work, axis=1)
    scale = np.max(np.abs(solution.work[:, solution.work_names.index("length_in_time")]))
    assert np.max(np.abs(total - total[0])) < 1e-9 * scale


@pytest.mark.check
def test_derivatives_by_length_and_rate_agree_with_differences_of_runs():
    model, start = dj.build(scene([{**table()[0], "time": [0.0, 0.503, 1.507, 3.0, 4.0]}]))
    stepper = dj.make_stepper(model, "energy_momentum")

    @jax.jit
    def loads(shift):
        """Peak and mean of the tension by the final length and by the rate."""
        entry = entry_of(model)
        entry = replace(entry, length=entry.length.at[3:].add(shift[0]), time=entry.time.at[2].add(shift[1]))
        run = dj.integrate(stepper, with_entry(model, entry), start, 0.01, 400)[1]
        return jnp.stack([jnp.max(run.tension), jnp.mean(run.tension)])

    exact = jax.jacrev(loads)(jnp.zeros(2))
    step = 1e-5
    by_differences = np.stack([(loads(step * e) - loads(-step * e)) / (2.0 * step) for e in np.eye(2)], axis=1)
    assert np.allclose(exact, by_differences, rtol=1e-5, atol=1e-6 * np.max(np.abs(by_differences)))
    assert np.all(np.abs(exact[:, 1]) > 1.0)


def test_statics_use_the_length_at_the_start():
    model, start = dj.build(scene(table()))

    def depth(length):
        return -dj.equilibrium(with_entry(model, entry_of(model, length=length))).state.r[0, 2]

    length = jnp.asarray(TABLE)
    stretched = 1.0 + MASS * GRAVITY / EA
    assert np.isclose(depth(length.at[0].set(4.0)), 4.0 * stretched, rtol=1e-9)
    assert np.allclose(jax.grad(depth)(length), [stretched, 0.0, 0.0, 0.0, 0.0], rtol=1e-9)


def winch(**more):
    control = {"target": 500.0, "gain": [2e-4, 4e-4], "limits": [-1.0, 1.0], "lengths": [1.0, 6.0], **more}
    return [{"end": "to", "control": control}]


@pytest.mark.check
def test_winch_follows_its_equations_to_first_order():
    """Two links between fixed points, 5.2 m apart: tension rises from 160 N to the target of 500 N."""
    span = 5.2
    table = scene(winch(), links=2)
    table["point"][1] = fixed("mass", span, 0.0, 0.0)
    table["effects"] = {}
    table["start"] = {"kind": "positions", "positions": [[0.0, 0.0, 0.0], [span / 2, 0.0, 0.0], [span, 0.0, 0.0]]}
    half = 0.5 * LENGTH
    mass = 0.5 * MASS

    def slope(t, y):
        x, v, length, integral = y
        first = EA * (x / half - 1.0) + BA * v / half
        spring = EA * ((span - x) / length - 1.0) - BA * v / length
        # the rate changes the tension that sets it: rate = k_p (spring - BA rate/length - target) + k_i integral
        rate = (2e-4 * (spring - 500.0) + 4e-4 * integral) / (1.0 + 2e-4 * BA / length)
        return [v, (spring - BA * rate / length - first) / mass, rate, spring - BA * rate / length - 500.0]

    exact = solve_ivp(slope, (0.0, DURATION), [span / 2, 0.0, half, 0.0], rtol=1e-8, atol=1e-9).y[:, -1]
    model, start = dj.build(table)
    stepper = dj.make_stepper(model, "energy_momentum")
    errors = []
    for count in (400, 800):
        run = jax.jit(partial(dj.integrate, stepper, steps=count))
        last, _ = run(model, start, DURATION / count)
        errors.append(abs(last.own["length_in_time"][0].length - exact[2]))
    assert errors[1] < 1e-3
    assert 1.6 < errors[0] / errors[1] < 2.4
    first, end = (observe(model, s.r, s.v, s.t, internal=s.own) for s in (start, last))
    added = end.kinetic + end.potential - first.kinetic - first.potential
    assert np.isclose(added, jnp.sum(last.work), rtol=1e-9)
    entry = entry_of(model, limits=jnp.array([-0.02, 0.02]))
    _, slow = run(with_entry(model, entry), start, DURATION / count)
    rates = np.diff(np.asarray(slow.own["length_in_time"][0].length)) / DURATION * count
    assert np.isclose(np.min(rates), -0.02)
    assert np.max(rates) <= 0.02 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("limits", "length"), [([-1.0, 1.0], 6.0), ([-1.0, 0.05], 3.0)], ids=["length limit", "rate limit"]
)
def test_a_winch_leaves_its_limit_once_its_integral_has_fallen(limits, length):
    """100 N below the target the integral I falls by 1 N s per step; the rate is -0.2 + 0.01 I within the limits."""
    control = {"target": 500.0, "gain": [2e-3, 1e-2], "limits": limits}
    model, _ = dj.build(scene(winch(**control)))
    now = WinchState(jnp.zeros(()), jnp.array(length), jnp.zeros(()), jnp.array(30.0))
    h = 0.01
    for step in range(20):
        entry = model.effect("length_in_time").entries[0].with_state(now)
        now = entry.advance(jnp.array((step + 1) * h), jnp.array([400.0]), h)
        wanted = -0.2 + 0.01 * (30.0 - (step + 1))
        assert float(now.rate) == pytest.approx(np.clip(wanted, limits[0], 0.0 if length == 6.0 else limits[1]))


@pytest.mark.check
def test_derivatives_of_peaks_by_gains_of_a_winch_agree_with_differences_of_runs():
    """A mass on a heaving drum, whose winch keeps the tension near the weight."""
    heaving = {"point": "drum", "amplitude": [0.0, 0.0, 0.3], "period": 1.7, "ramp": 1.0}
    table = scene(winch(target=MASS * GRAVITY, limits=[-5.0, 5.0]))
    table["effects"]["end_motion"] = heaving
    model, start = dj.build(table)
    stepper = dj.make_stepper(model, "energy_momentum")
    window = jnp.full(20, 1.0 / 20)  # 0.2 s

    @jax.jit
    def peaks(gain):
        run = dj.integrate(stepper, with_entry(model, entry_of(model, gain=gain)), start, 0.01, 400)[1]
        means = jnp.convolve(run.tension[:, 0], window, mode="valid")
        return jnp.stack([jnp.max(run.tension), jnp.max(means)])

    gain = jnp.array([3e-3, 2e-3])
    assert peaks(jnp.zeros(2))[1] > 1.25 * peaks(gain)[1]
    exact = jax.jacrev(peaks)(gain)
    step = 1e-4 * gain
    columns = [(peaks(gain + step * e) - peaks(gain - step * e)) / (2.0 * jnp.sum(step * e)) for e in jnp.eye(2)]
    assert np.allclose(exact, np.stack(columns, axis=1), rtol=1e-5)


@pytest.mark.parametrize(
    ("control", "message"),
    [
        ({"target": 200.0, "gain": [1e-3, 0.0]}, None),
        ({"target": 200.0, "gain": [0.5, 0.0]}, "winch of rope: swings between its limits of -1 and 1 m/s from 0."),
        ({"lengths": [4.9, 6.0]}, "winch of rope: ends at its limit of 4.9 m, so the tension is not the target."),
    ],
    ids=["stable", "unstable gain", "used up"],
)
def test_a_run_reports_faults_of_its_winch(control, message):
    printed = [text for text in dj.simulate(scene(winch(**control))).warnings if "winch" in text]
    assert message in printed[0] if message else not printed


@pytest.mark.parametrize(
    ("changing", "more", "message"),
    [
        (table(length=[5.0, 5.0, 0.0, 4.4, 4.4]), {}, "length_in_time.0.length.2: 0.0 is out of range"),
        (table(length=[4.0, 5.0, 3.0, 4.4, 4.4]), {}, "length: 4 m at t = 0, but these links of 'rope' are 5 m long"),
        (table(), {"duration": 9.0}, "time: 0 to 4 s, but the run lasts from 0 to 9 s"),
        (table(links=3), {}, "length_in_time.0.links: 3, but 'rope' has 1 links; allowed: 1 to 1"),
        (table(time=[0.0, 0.5, 0.4, 3.0, 4.0]), {}, "time: [0.0, 0.5, 0.4, 3.0, 4.0] does not rise"),
        (table(link=1), {}, "needs `end` ('from' or 'to'), or `link`; one of them"),
        (table(control=winch()[0]["control"]), {}, "or `control`; one of the two"),
        (winch(limits=[0.1, 0.2]), {}, "control.limits: [0.1, 0.2] does not contain 0"),
        (table(), {"integrator": "generalized_alpha"}, "it needs constant lengths"),
        (table(), {"law": "rigid"}, "the links of 'rope' are rigid. Use a line that stretches"),
    ],
)
def test_bad_input_gives_one_line(changing, more, message, refusal):
    assert message in refusal(dj.simulate, scene(changing, **more))


def test_a_link_has_one_length_in_time(refusal):
    model, _ = dj.build(scene(table()))
    assert "have another length in time" in refusal(dj.with_length_in_time, model, smooth_by_jax, 3.8)


def test_table_survives_writing_and_reading():
    loaded = dj.load_scene(scene([*table(between="smooth", length=[2.5, 2.5, 2.0, 2.0, 2.0]), *winch()], links=2))
    again = dj.load_scene(loaded.to_dict())
    assert again.to_dict() == loaded.to_dict()
    changed = again.with_values({"line.rope.length_in_time.0.length.2": 3.0})
    assert changed.line.length_in_time[0].length[2] == 3.0
