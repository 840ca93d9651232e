"""Regular waves of finite height against published solutions, the package raschii, and the laws of the surface."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax.cli import main
from dropper_jax.load.sea_warnings import sea_warnings
from dropper_jax.sea.make import finite_wave, make_sea
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.steady import GivenWave, fitting_theory, highest
from dropper_jax.sea.stokes5 import stokes5
from dropper_jax.sea.stream_function import Inaccurate, NotSolved, stream_function

#: Solutions of Fenton's program FOURIER with its current criterion, as people published its file Solution.res, in
#: units of depth and gravity: H, T, then length, celerity, volume flux in the frame of the wave, Bernoulli constant
#: (erdc/proteus nonlinearWaves, erdc/air-water-vv OWC trials, whtsao/AP_OMAE2022, whtsao/complex_object_in_wave_flume,
#: dbarre5/tutorials, jasper-aurora/Fourier, ChiaCheng-Tsai/FentonStokesClass). The last is by cnoidal theory: the wave
#: of Le Mehaute, Divoky and Lin (1968), figure 8, without mass transport.
PUBLISHED = [
    (0.0250, 3.6283, "euler", 0.0, 2.0880, 0.5755, 0.5753, 1.1656),
    (0.0485, 2.8485, "euler", 0.0, 1.3089, 0.4595, 0.4588, 1.1056),
    (0.0485, 4.1539, "euler", 0.0, 2.7031, 0.6507, 0.6503, 1.2117),
    (0.0971, 3.7157, "euler", 0.0, 2.2240, 0.5985, 0.5966, 1.1792),
    (0.0971, 3.7971, "euler", 0.0, 2.3152, 0.6097, 0.6078, 1.1859),
    (0.1800, 5.6378, "euler", 0.001, 4.5606, 0.8089, 0.8030, 1.3271),
    (0.1870, 4.7571, "euler", 0.0, 3.5153, 0.7390, 0.7331, 1.2734),
    (0.2000, 3.0000, "euler", 0.0, 1.6526, 0.5509, 0.5424, 1.1517),
    (0.3000, 8.5153, "euler", 0.0, 8.0000, 0.9395, 0.9279, 1.4446),
    (0.3000, 10.000, "euler", 0.0, 9.6897, 0.9690, 0.9579, 1.4730),
    (0.3750, 9.9045, "euler", 0.0, 9.7556, 0.9850, 0.9684, 1.4901),
    (0.4920, 22.470, "stokes", 0.0, 24.9115, 1.1087, 1.1087, 1.6371),
]


def values(wave):
    return np.array([wave.length, wave.celerity, wave.flux, 1.0 + wave.head])


@pytest.mark.parametrize("point", PUBLISHED, ids=lambda p: f"H {p[0]} T {p[1]}")
def test_the_stream_function_gives_published_solutions_to_a_percent(point):
    height, period, criterion, current, *expected = point
    wave = stream_function(GivenWave(height, 1.0, 1.0, period=period, criterion=criterion, current=current))
    # the printed digits; the cnoidal theory of the last is good to some thousandths
    tolerance = 2e-4 if criterion == "euler" else 5e-3
    np.testing.assert_allclose(values(wave), expected, rtol=tolerance)
    if fitting_theory(height, wave.length, 1.0) == "stokes5":
        stokes = stokes5(GivenWave(height, 1.0, 1.0, period=period, criterion=criterion, current=current))
        np.testing.assert_allclose(values(stokes), expected, rtol=1e-3)


def test_published_harmonics_are_met():
    # FentonStokesClass, H 0.2 d, T 3: 86 % of the highest; B_1, B_2 sqrt(g/k^3) are those of the potential, E_j k
    wave = stream_function(GivenWave(0.2, 1.0, 1.0, period=3.0))
    k = wave.wave_number
    surface = [0.34415007, 0.077124456, 0.027655267, 0.012081391, 0.0058781740]
    np.testing.assert_allclose(k * wave.surface[:5], surface, rtol=1e-4)
    b = wave.speed * np.sqrt(k) / np.arange(1, wave.order + 1)
    np.testing.assert_allclose(b[:3], [0.33379590, 0.010903272, 0.0014006866], rtol=1e-3)


@pytest.mark.parametrize("length", [0.7, 4.0, pytest.param(12.0, marks=pytest.mark.check)])  # long: raschii is slow
def test_raschii_finds_the_same_wave_at_90_percent_of_breaking(length):
    raschii = pytest.importorskip("raschii")
    height = 0.9 * highest(length, 1.0)
    wave = stream_function(GivenWave(height, 1.0, 1.0, length=length))
    other = raschii.FentonWave(height=height, depth=1.0, length=length, N=wave.order, g=1.0)
    x = np.array([0.0, 0.1, 0.3, 0.5]) * length
    phase = 2 * np.pi * x / length
    assert wave.celerity == pytest.approx(other.c, rel=1e-6)
    np.testing.assert_allclose(wave.elevation(phase), other.surface_elevation(x) - 1.0, atol=1e-6 * height)
    z = np.minimum(-0.2, wave.elevation(phase))
    np.testing.assert_allclose(wave.velocity(phase, z), other.velocity(x, z + 1.0), atol=1e-6)


@pytest.mark.parametrize("length", [0.5, 1.0, 3.0, 5.0, 5.9])
def test_stokes_fifth_is_within_a_percent_where_it_is_chosen(length):
    height = 0.5 * highest(length, 1.0)
    assert fitting_theory(height, length, 1.0) == "stokes5"
    exact = stream_function(GivenWave(height, 1.0, 1.0, length=length))
    found = stokes5(GivenWave(height, 1.0, 1.0, period=exact.period))
    np.testing.assert_allclose(values(found), values(exact), rtol=1e-3)
    assert found.crest == pytest.approx(exact.crest, rel=1e-2)
    phase, z = np.linspace(0, np.pi, 7), np.full(7, -0.3)
    top = np.max(np.abs(exact.velocity(phase, z)))
    np.testing.assert_allclose(found.velocity(phase, z), exact.velocity(phase, z), atol=1e-2 * top)


def test_raschii_has_the_same_stokes_wave():
    raschii = pytest.importorskip("raschii")
    wave = stokes5(GivenWave(0.2, 1.0, 9.81, length=3.0))
    other = raschii.StokesWave(height=0.2, depth=1.0, length=3.0, N=5)
    x, z = np.linspace(0.0, 1.5, 6), np.full(6, -0.4)
    phase = 2 * np.pi * x / 3.0
    np.testing.assert_allclose(wave.elevation(phase), other.surface_elevation(x) - 1.0, atol=1e-14)
    np.testing.assert_allclose(wave.velocity(phase, z), other.velocity(x, z + 1.0), atol=1e-13)


def test_beyond_and_outside_the_other_theory_is_chosen():
    assert fitting_theory(0.001, 5.0, 1.0) == "linear"
    assert fitting_theory(0.52 * highest(5.0, 1.0), 5.0, 1.0) == "stream"
    assert fitting_theory(0.3 * highest(6.5, 1.0), 6.5, 1.0) == "stream"


@pytest.mark.check
def test_the_highest_waves_end_at_the_limit_of_williams():
    # deep water 0.1411 L, solitary wave 0.8332 d; Newton's method itself gets to within 5 % and not beyond
    assert highest(1.0, 1e4) == pytest.approx(0.141063, rel=1e-4)
    assert highest(1e6, 1.0) == pytest.approx(0.8332, rel=1e-3)
    for length in (1.5, 8.0):
        assert stream_function(GivenWave(0.95 * highest(length, 1.0), 1.0, 1.0, length=length)).error < 1e-3
        with pytest.raises(NotSolved) as caught:
            stream_function(GivenWave(1.03 * highest(length, 1.0), 1.0, 1.0, length=length))
        assert caught.value.reached <= 1.001 * highest(length, 1.0)


def test_a_closed_flume_has_no_mass_transport_and_a_current_only_carries_the_wave():
    still = stream_function(GivenWave(0.3, 1.0, 1.0, length=6.0))
    flume = stream_function(GivenWave(0.3, 1.0, 1.0, length=6.0, criterion="stokes"))
    assert flume.transport == pytest.approx(0.0, abs=1e-12)
    assert flume.eulerian == pytest.approx(-still.transport, rel=1e-9)
    carried = stream_function(GivenWave(0.3, 1.0, 1.0, period=6.0 / (still.celerity + 0.2), current=0.2))
    assert carried.length == pytest.approx(6.0, rel=1e-9)  # Galilei
    # the mass that is carried, from the velocities themselves, over the depth at a fixed place and over a period
    phase = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    flux = []
    for one in phase:
        eta = still.elevation(np.array([one]))[0]
        x, weight = np.polynomial.legendre.leggauss(24)
        z = -1.0 + (1.0 + eta) * 0.5 * (x + 1.0)
        flux.append(0.5 * (1.0 + eta) * weight @ still.velocity(np.full(24, one), z)[:, 0])
    assert np.mean(flux) == pytest.approx(still.transport, rel=1e-6)


def sea_of(**waves):
    more = {key: waves.pop(key) for key in ("current", "wave_current", "ramp", "interpolation") if key in waves}
    table = {"depth": 10.0, "waves": {"kind": "regular", "theory": "stream", **waves}, **more}
    return SeaSpec.read(table, "sea")


STEEP = {"height": 4.0, "period": 7.0, "direction": 0.3, "phase": 0.4}


@pytest.fixture(scope="module")
def steep():
    return make_sea(sea_of(**STEEP))


def test_both_conditions_hold_at_the_surface_that_effects_see(steep):
    t = jnp.asarray(1.7)
    x, y = jnp.asarray(np.random.default_rng(0).uniform(-40, 40, (2, 30)))
    eta = steep.waves.elevation(x, y, t)
    r = jnp.stack([x, y, eta], axis=1)
    wave = finite_wave(sea_of(**STEEP))
    along = np.array([np.cos(STEEP["direction"]), np.sin(STEEP["direction"]), 0.0])
    seen_by_wave = np.asarray(steep.at(r, t).velocity) - wave.celerity * along
    pressure = wave.head - 0.5 * np.sum(seen_by_wave**2, axis=1)  # over the density, by Bernoulli
    np.testing.assert_allclose(pressure / 9.81, eta, atol=1e-5)
    rate = jax.jvp(lambda s: steep.waves.elevation(x, y, s), (t,), (jnp.ones_like(t),))[1]
    slope = jax.vmap(jax.grad(lambda p: steep.waves.elevation(p[:1], p[1:2], t)[0]))(r)[:, :2]
    u = steep.at(r, t).velocity
    np.testing.assert_allclose(u[:, 2], rate + jnp.sum(u[:, :2] * slope, axis=1), atol=1e-4)
    assert float(eta.max()) > 2.3  # well above half of the height


def test_acceleration_is_the_rate_of_the_velocity_and_the_flow_a_potential_one(steep):
    r = jnp.asarray(np.random.default_rng(1).uniform([-30, -30, -10], [30, 30, -2.0], (20, 3)))
    t = jnp.asarray(2.2)
    rate = jax.jvp(lambda s: steep.at(r, s).velocity, (t,), (jnp.ones_like(t),))[1]
    np.testing.assert_allclose(steep.at(r, t).acceleration, rate, atol=1e-12)
    gradient = jax.vmap(jax.jacfwd(lambda place: steep.at(place[None], t).velocity[0]))(r)
    assert np.max(np.abs(np.trace(gradient, axis1=1, axis2=2))) < 1e-12
    assert np.max(np.abs(gradient - np.swapaxes(gradient, 1, 2))) < 1e-12
    bed = steep.at(r.at[:, 2].set(-10.0), t).velocity
    assert np.max(np.abs(bed[:, 2])) < 1e-12


def test_a_current_is_added_once():
    current = {"speed": 0.5, "direction": 0.3}
    carried = make_sea(sea_of(**STEEP, current=current, wave_current="doppler"))
    wave = finite_wave(sea_of(**STEEP, current=current, wave_current="doppler"))
    assert wave.eulerian == pytest.approx(0.5)
    r = jnp.asarray([[0.0, 0.0, -5.0]])
    times = jnp.linspace(0.0, wave.period, 257)[:-1]
    mean = jnp.mean(jax.vmap(lambda t: carried.at(r, t).velocity[0])(times), axis=0)
    np.testing.assert_allclose(mean[:2], 0.5 * np.array([np.cos(0.3), np.sin(0.3)]), atol=1e-9)
    closed = make_sea(sea_of(**STEEP, current_criterion="stokes"))
    mean = jnp.mean(jax.vmap(lambda t: closed.at(r, t).velocity[0])(times), axis=0)
    assert float(mean[0]) < -0.1  # the return flow of a closed flume


@pytest.mark.parametrize("speed", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["uniform", "power"])
def test_waves_on_a_current_have_the_given_length_and_no_flow_beyond_it(speed, kind):
    sea = {"current": {"kind": kind, "speed": speed}, "wave_current": "doppler"}
    low = {"stream": {"height": 0.002}, "linear": {"amplitude": 0.001}}
    for given in ({"length": 40.0}, {"period": 5.0}):
        found = {theory: make_sea(sea_of(**sea, **given, **size, theory=theory)).waves for theory, size in low.items()}
        stream, linear = found["stream"], found["linear"]
        np.testing.assert_allclose(stream.wave_number[0], linear.wave_number[0], rtol=1e-6)
        np.testing.assert_allclose(stream.omega[0], linear.omega[0], rtol=1e-6)
        assert stream.drift is None or abs(float(stream.drift)) < 1e-9
        if "length" in given:
            np.testing.assert_allclose(linear.wave_number, 2 * np.pi / 40.0, rtol=1e-9)


def test_low_waves_are_linear_ones():
    low = make_sea(sea_of(height=0.002, period=5.0))
    linear = make_sea(sea_of(amplitude=0.001, period=5.0, theory="linear"))
    r, t = jnp.asarray([[3.0, 1.0, -2.0], [0.0, 0.0, -8.0]]), jnp.asarray(0.7)
    for a, b in zip(low.at(r, t), linear.at(r, t), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-6)
    by_length = sea_of(theory="linear", amplitude=1.0, length=float(linear.waves.shortest))
    assert float(make_sea(by_length).waves.omega[0]) == pytest.approx(2 * np.pi / 5.0, rel=1e-12)


def test_a_wave_that_needs_more_harmonics_is_not_called_breaking():
    # 0.9 of the highest wave, of 60 depths
    with pytest.raises(Inaccurate, match="with 80 harmonics"):
        stream_function(GivenWave(0.7259, 1.0, 9.81, length=60.0))


@pytest.mark.parametrize(
    ("waves", "start"),
    [
        ({"height": 9.0}, "waves.height: 9 m is at or above breaking; allowed: below 6.4"),
        (  # 0.95 of the highest wave of this length
            {"height": 7.5, "period": None, "length": 300.0},
            "waves.height: 7.5 m is too close to breaking to be solved; allowed: up to about 7",
        ),
        ({"amplitude": 0.5}, "waves.height: cannot be combined with `amplitude`"),
        ({"length": 50.0}, "waves.length: cannot be combined with `period`"),
        ({"period": None}, "waves.period: missing"),
        ({"height": -1.0}, "waves.height: -1.0 is out of range"),
        ({"height": None, "amplitude": 0.0}, "waves.amplitude: 0.0 is not a wave"),
        ({"theory": "strem"}, "waves.theory: 'strem' is unknown; did you mean"),
        ({"theory": "auto", "order": 9}, "waves.order: 9 is not used by theory 'auto'"),
        (
            {"theory": "linear", "current_criterion": "stokes"},
            "waves.current_criterion: 'stokes' is not used by theory 'linear'",
        ),
        (
            {"theory": "linear", "period": None, "length": 10.0, "current": {"speed": -3.0}, "wave_current": "doppler"},
            "wave_current: the current stops waves of 10 m",
        ),
        ({"interpolation": "grid"}, "interpolation: 'grid' cannot be combined with waves of"),
        (
            {"wave_current": "action", "current": {"speed": 0.1}},
            "wave_current: 'action' cannot be combined with waves of theory 'stream'",
        ),
    ],
)
def test_waves_that_cannot_be_are_refused_in_one_line(waves, start, refusal):
    given = {key: value for key, value in {"height": 1.0, "period": 7.0, **waves}.items() if value is not None}
    assert refusal(lambda: make_sea(sea_of(**given))).startswith(f"sea.{start}")


SCENE = system(
    [fixed("a", 0, 0, -1.0), free("b", 0, 0, -4.0)],
    [line_of("l", "a", "b", 3, 1.0, mass=12.0, diameter=0.08)],
    dt=0.04,
    effects={"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.1}, "morison_inertia": {"can": 0.8}},
    start={"kind": "angles", "zero": "down", "polar": [0.0] * 3},
    sea={"depth": 10.0, "waves": {"kind": "regular", "theory": "stream", **STEEP}},
)


@pytest.mark.check
def test_gradients_of_a_run_agree_forward_reverse_and_with_differences(slopes_of):
    model, state = dj.build(SCENE)
    stepper = dj.make_stepper(model, halvings=0)
    waves, order = model.sea.waves, jnp.arange(1.0, model.sea.waves.size + 1)

    def final(p):
        phase, direction, size = p
        sizes = {"speed": size * waves.speed, "amplitude": size * waves.amplitude}
        new = replace(waves, phase=phase * order, direction=direction, **sizes)
        s, _ = dj.integrate(stepper, replace(model, sea=replace(model.sea, waves=new)), state, 0.04, 20)
        return jnp.sum(s.r * jnp.array([1.0, -0.7, 0.4]))

    slopes_of(final, jnp.array([0.4, 0.3, 1.0]), 1e-5)


def test_a_scene_reports_waves_outside_their_theory_and_keeps_its_keys():
    scene = dj.load_scene(SCENE)
    assert dj.Scene.from_dict(scene.to_dict()) == scene
    assert "theory" not in dj.load_scene("wet-pendulum-wave").to_dict()["sea"]["waves"]
    near = scene.with_values({"sea.waves.height": 6.0})
    assert "is 0.9" in " ".join(sea_warnings(near, make_sea(near.sea)))
    long = scene.with_values({"sea.waves.theory": "stokes5", "sea.waves.period": 9.0})
    assert "'stokes5' is inaccurate for this wave, its length is" in " ".join(sea_warnings(long, make_sea(long.sea)))


def test_the_command_describes_the_sea(tmp_path, json_of):
    picture = tmp_path / "regimes.png"
    given = ["sea", "wet-pendulum-wave", "--set", "sea.waves.theory=auto", "--json", "--regimes", str(picture)]
    found = json_of(given)["waves"]
    assert found["theory"] == found["fitting_theory"] == "stokes5"
    assert picture.stat().st_size > 10_000
    found = json_of(["sea", "edulis-longline", "--json"])["waves"]
    # 2 pi Hs/(g Tz^2) against 1/10 at Tz = 6 s and 1/15 at 12 s
    tz = found["mean_period_s"]
    steepest = (0.1 - (tz - 6.0) / 6.0 * (0.1 - 1 / 15)) * 9.81 * tz**2 / (2 * np.pi)
    assert found["breaking_hs_m"] == pytest.approx(steepest, rel=1e-9)
    assert main(["sea", "string"]) == 2
