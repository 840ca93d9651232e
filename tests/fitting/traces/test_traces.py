"""Traces: the CSV contract, conventions, and one clear line for everything that cannot be fitted."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

import dropper_jax as dj
from dropper_jax import SceneError
from fitting import Convention, Trace, read_trace, simulate_truth, write_trace
from fitting.estimate.first_starts import local_motion
from fitting.parameters.names import full_names
from fitting.parameters.paths import resolve
from fitting.traces import planar
from fitting.traces.conventions import check_scale, settle_convention
from fitting.traces.noise import DEGREE, noise, smooth
from fitting.traces.trace import check_trace
from fitting.traces.trace_file import as_trace

ANY = Convention()


@pytest.fixture(scope="module")
def dropper():
    return dj.build("dropper-release-a")


def still_swinging(model, start, count=200):
    """A made-up motion that closes: the release pose, every other sample the resting one."""
    theta, _ = planar.from_nodes(model, start.r, start.v)
    wobble = 0.02 * np.sin(np.arange(count) * 0.2)[:, None] * np.ones(7)
    t = np.arange(count) / 60
    return Trace("made-up", t, np.asarray(theta) + wobble)


def write(tmp_path, text, name="run.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


def rows(count=20, names="t,theta_1", value=lambda i: f"{np.sin(i):.6f}"):
    return names + "\n" + "\n".join(f"{i * 0.01:.3f},{value(i)}" for i in range(count)) + "\n"


def test_a_trace_survives_writing_and_reading(tmp_path):
    t = np.arange(30) / 60
    theta = np.sin(t)[:, None] * np.array([1.0, 2.0])
    theta[3, 1] = np.nan
    before = Trace(
        "x", t, theta, se=np.full_like(theta, 0.01), convention=Convention("down", -1, "deg"), model_error=0.1
    )
    after = read_trace(write_trace(tmp_path / "x.csv", before))
    np.testing.assert_allclose(after.theta, theta, atol=1e-8)
    np.testing.assert_allclose(after.se, 0.01)
    assert after.convention == Convention("down", -1, "deg")
    assert after.model_error == 0.1
    assert after.in_model_convention(after.convention).model_error == pytest.approx(np.deg2rad(0.1))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (rows(names="t,theta_2"), "unknown column .theta_2."),
        ("t,theta_1\n", "no samples"),
        (rows(value=lambda i: "x"), "not a number"),
        (rows(value=lambda i: '"1' if i == 5 else "1"), "unexpected end of data; is a quotation mark not closed"),
        ("# unit=rad, model_error=-1\n" + rows(), "model_error = '-1': not an angle"),
        ("# unit=rad, model_error=1.2.3\n" + rows(), "model_error = '1.2.3': not an angle"),
        (rows(value=lambda i: ""), "every sample is missing"),
        (rows(value=lambda i: "0.5"), "constant"),
        (rows(count=5), "at least"),
        ("t,theta_1\n0,1\n0.02,2\n0.01,3\n" + "".join(f"{i},1\n" for i in range(1, 20)), "goes back"),
        ("t,theta_1\n0,1\n0.01,2\n0.01,3\n" + "".join(f"{i},1\n" for i in range(1, 20)), "is repeated"),
        ("# unit=rad, model_error=2 deg\n" + rows(), "model_error = '2 deg': not an angle"),
        ("# unit=rad, model_error=inf\n" + rows(), "model_error = 'inf': not an angle"),
        ("# units=deg, zero=down\n" + rows(), "unknown key 'units' in a comment; did you mean 'unit'"),
        ("# Zero: down\n" + rows(), "unknown key 'Zero' in a comment; did you mean 'zero'"),
        ("# zero=down, unit=rad\n# unit=deg\n" + rows(), "unit = 'rad' and unit = 'deg'; allowed: one value"),
        ("# zero=up\n" + rows(), "zero = 'up' is unknown"),
        (rows().replace("0.050,", "0.050,1,"), "one per column"),
        (rows().replace("t,theta_1\n", ""), "has no header"),
        (rows().replace(".", ","), "decimal commas in a file with comma-separated columns"),
        (rows(value=lambda i: "-999" if i % 5 == 2 else f"{np.sin(i):.6f}"), "-999 in 4 rows, .* allowed: empty cells"),
        (rows(value=lambda i: "n/a" if i == 4 else f"{np.sin(i):.6f}"), "leave the cells of missing samples empty"),
        (rows() + rows().partition("\n")[2], "row 21 starts again: two runs in one file"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_in_one_line(tmp_path, text, words):
    with pytest.raises(SceneError, match=words) as caught:
        read_trace(write(tmp_path, text))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("number", ["1e-1", "0.01e1", "+0.1", "1.0e-1"])
def test_values_of_comments_are_read_after_an_equals_sign_or_a_colon(tmp_path, number):
    text = f"# fps=60 sign=-1\n# zero: down, unit: deg; model_error={number}\n# at 12:30, unit = deg\n"
    trace = read_trace(write(tmp_path, text + rows()))
    assert trace.convention == Convention("down", -1, "deg")
    assert trace.model_error == 0.1


def test_notes_and_warnings_of_any_text_leave_a_written_trace_as_it_was(tmp_path):
    t = np.arange(30) / 60
    before = Trace("x", t, np.sin(t)[:, None], convention=Convention("down", 1, "rad"), warnings=("one\nunit=deg",))
    marked = "marked 0.1 to 0.2 s: nodes 1 2 (swapped)"
    file = write_trace(tmp_path / "x.csv", before, [marked, "unit=deg", "zero: horizontal", "two\nlines, sign: -1", ""])
    assert f"# {marked}" in file.read_text().splitlines()
    after = read_trace(file)
    assert after.convention == before.convention
    assert after.warnings == ("one unit=deg",)
    np.testing.assert_allclose(after.theta, before.theta, atol=1e-8)


def test_times_since_1970_survive_writing_and_reading(tmp_path):
    t = 1.7e9 + np.arange(30) / 100
    after = read_trace(write_trace(tmp_path / "x.csv", Trace("x", t, np.sin(30 * (t - t[0]))[:, None])))
    np.testing.assert_array_equal(after.t, t)


@pytest.mark.parametrize(
    "encode",
    [
        lambda text: text.replace(",", ";").encode(),
        lambda text: text.replace(",", ";").replace(".", ",").encode("utf-8-sig"),
        lambda text: text.replace(",", "\t").replace(".", ",").replace("\n", "\r\n").encode("utf-16"),
        lambda text: ("sep=;\n" + text.replace(",", ";")).encode(),
        lambda text: text.replace(",", "  ").encode(),
        lambda text: text.replace("t,theta_1", '"t", "theta_1"').encode("utf-8-sig"),
    ],
    ids=["semicolons", "decimal commas, BOM", "tabs, UTF-16", "a note of the separator", "spaces", "quoted names"],
)
def test_a_file_as_spreadsheets_write_it_is_read(tmp_path, encode):
    path = tmp_path / "run.csv"
    path.write_bytes(encode(rows()))
    trace = read_trace(path)
    np.testing.assert_allclose(trace.t, np.arange(20) * 0.01, atol=1e-12)
    np.testing.assert_allclose(trace.theta[:, 0], np.sin(np.arange(20)), atol=1e-6)


def test_values_that_a_coarse_encoder_repeats_are_no_mark_of_missing_samples(tmp_path):
    """A decaying swing in steps of 0.02 rad, which ends at rest between two steps."""
    rng = np.random.default_rng(0)
    swing = lambda i: np.sin(0.3 * i) * np.exp(-i / 60)  # noqa: E731
    text = rows(600, value=lambda i: f"{0.02 * np.round((swing(i) + 0.005 * rng.standard_normal()) / 0.02):.3f}")
    assert read_trace(write(tmp_path, text)).links == 1


FRAMES = np.arange(3000) / 60
#: Up to a quarter of an interval early or late, in which the angle changes by twenty times the noise.
IRREGULAR = (np.arange(1200) + np.random.default_rng(2).uniform(-0.25, 0.25, 1200)) / 100


@pytest.mark.parametrize(
    ("t", "motion", "size", "within"),
    [
        (FRAMES, lambda t: np.sin(9 * t) + 0.3 * np.sin(17 * t), 0.005, 0.1),
        (IRREGULAR, lambda t: np.sin(8 * t), 0.003, 0.15),
        (
            FRAMES[:600],
            lambda t: np.cumsum(50 * np.exp(-0.5 * t) * np.sin(12 * t + 3 * np.sin(7 * t))) / 60,
            0.004,
            0.2,
        ),
    ],
    ids=["smooth motion", "irregular frames", "links that whip for a part of the time"],
)
def test_the_noise_of_a_motion_is_found(t, motion, size, within):
    theta = motion(t)[:, None] * [1.0, 0.7] + size * np.random.default_rng(1).standard_normal((len(t), 2))
    np.testing.assert_allclose(noise(Trace("x", t, theta)), size, rtol=within)


def test_missing_samples_leave_the_noise_as_it_is():
    rng = np.random.default_rng(1)
    theta = np.sin(9 * FRAMES)[:, None] + 0.003 * rng.standard_normal((len(FRAMES), 2))
    theta[::2, 0] = np.nan  # as of two cameras that take turns
    theta[rng.random(len(FRAMES)) < 0.3, 1] = np.nan
    np.testing.assert_allclose(noise(Trace("x", FRAMES, theta)), 0.003, rtol=0.1)


def test_the_noise_is_at_least_the_rounding_of_the_sensor():
    t = np.arange(600) / 60
    rounded = np.round(np.exp(-t) * np.sin(9 * t) / 0.01) * 0.01
    assert noise(Trace("x", t, rounded[:, None])) >= 0.01 / np.sqrt(12) * (1 - 1e-9)


def test_the_local_motion_is_exact_on_cubics_with_gaps_and_does_not_smooth_a_whip_away():
    t = np.linspace(0, 1, 60) ** 1.2
    y = 1 + 2 * t - 3 * t**2 + t**3
    y[10:20] = np.nan
    ((value, slope),) = local_motion(t, y[:, None], 0.3, np.array([1e-9]), 0.2)
    assert value == pytest.approx(1 + 0.6 - 0.27 + 0.027, abs=1e-10)
    assert slope == pytest.approx(2 - 1.8 + 0.27, abs=1e-8)
    t = np.arange(200) / 200
    (found,) = local_motion(t, np.sin(60 * (t - 0.5))[:, None], 0.5, np.array([1e-3]), 0.1)
    np.testing.assert_allclose(found, (0.0, 60.0), rtol=0.01, atol=2e-3)


def test_the_convention_of_a_closed_loop_is_guessed_from_closure_and_gravity(dropper):
    model, start = dropper
    true = still_swinging(model, start)
    for zero, sign in (("horizontal", 1), ("horizontal", -1), ("down", 1), ("down", -1)):
        measured = np.pi / 2 - true.theta if zero == "down" else true.theta
        trace = Trace("x", true.t, sign * measured)
        found, warnings = settle_convention(trace, model, ANY)
        assert found.convention == Convention(zero, sign, "rad")
        assert warnings
        np.testing.assert_allclose(np.cos(found.theta - true.theta), 1.0, atol=1e-12)


SECOND_FRAMES = (np.arange(200)[:, None] + np.arange(7)) % 2


@pytest.mark.parametrize(
    ("spread", "size", "missing", "given", "words"),
    [
        (1.0, 1.0, 0, Convention("horizontal", -1, "rad"), "zero=horizontal, sign=-1 is .* rad from the scene's pose"),
        (1.0, np.degrees(1.0), 0, ANY, "looks like degrees. Use --unit deg"),
        (1.0, np.degrees(1.0), 0, Convention(unit="rad"), "looks like degrees. The unit is rad. Use --unit deg"),
        (1.0, np.degrees(1.0), SECOND_FRAMES, ANY, "looks like degrees"),
        (1.0, 1.0, SECOND_FRAMES, Convention(unit="deg"), "looks like radians"),
        (20.0, 1.0, 0, ANY, "too few per oscillation"),
    ],
)
def test_angles_that_the_scene_contradicts_are_refused(dropper, spread, size, missing, given, words):
    trace = still_swinging(*dropper)
    swing = 0.5 * np.sin(np.arange(200) * 0.2)[:, None] * (size > 1)
    measured = Trace("x", spread * trace.t, np.where(missing, np.nan, size * (trace.theta + swing)))

    def settle():
        check_scale(measured, dropper[0], given)
        return settle_convention(measured, dropper[0], given)

    with pytest.raises(SceneError, match=words):
        settle()


def test_gaps_between_known_samples_are_crossed_up_to_their_length():
    """A line of 2 rad/s, of which a second link is never seen, a third one in two frames far apart."""
    t = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 1.0, 2.0])
    theta = np.tile(2 * t[:, None], 3)
    theta[[0, 2, 3], 0] = np.nan
    theta[:, 1] = np.nan
    theta[1:-1, 2] = np.nan
    found = Trace("x", t, theta).across_gaps(0.6)
    np.testing.assert_allclose(found[:, 0], [np.nan, 0.2, 0.4, 0.6, 0.8, 2.0, 4.0])
    assert np.isnan(found[:, 1]).all()
    np.testing.assert_array_equal(found[:, 2], theta[:, 2])


@pytest.mark.parametrize(
    ("option", "names"), [("free", ["b_x"]), ("to", ["effects.weight.b_l"]), ("vary", ["line.0.mass.9"])]
)
def test_a_wrong_name_is_called_after_the_option_that_gave_it(dropper, option, names):
    with pytest.raises(SceneError, match=f"^{option}: '{names[0]}'"):
        resolve(dropper[0], full_names(dj.load_scene("dropper-release-a"), names, option), option=option)


NAMES = {"time": "stamp [s]", "theta_1": "alpha", "theta_2": "beta"}


def test_columns_of_other_names_are_read_by_name_and_others_left_out(tmp_path):
    cosine = lambda i: f"{np.sin(i):.6f},text,{np.cos(i):.6f}"  # noqa: E731
    text = rows(names="stamp [s],alpha,note,beta", value=cosine).replace("\n", "\n7,")
    path = write(tmp_path, "t," + text.removesuffix("7,"))
    trace = read_trace(path, 2, NAMES)
    np.testing.assert_allclose(trace.t, np.arange(20) * 0.01)
    np.testing.assert_allclose(trace.theta.T, [np.sin(np.arange(20)), np.cos(np.arange(20))], atol=1e-6)
    with pytest.raises(SceneError, match="columns: 'alhpa' is not in run.csv; did you mean 'alpha'"):
        read_trace(path, 2, NAMES | {"theta_1": "alhpa"})
    with pytest.raises(SceneError, match="columns: 'phi_1' is unknown; allowed: time, theta_1..n"):
        read_trace(path, 2, {"phi_1": "alpha"})


@pytest.mark.parametrize(
    ("header", "links", "words"),
    [
        (
            "timestamp,angle",
            1,
            "found: timestamp, angle; rename to t, theta_1, or --columns time=timestamp,theta_1=angle",
        ),
        ("t,angle", 1, "has no column 'theta_1'; found: t, angle; rename to t, theta_1, or --columns theta_1=angle"),
        (
            "frame,time [s],a,b,c,d,e,long_name_of_a_column,another_long_name_of_a_column,last",
            5,
            "found: frame, time [s], a, b, c, d, e, long_name_of_a_column and 2 more; "
            "rename to t, theta_1 ... theta_5, or --columns 'time=time [s],theta_1=frame',...",
        ),
        ("time,theta_1", None, "rename to t, theta_1 ... theta_n, or --columns time=time,..."),
    ],
)
def test_a_file_without_a_time_names_whole_columns_and_what_to_do(tmp_path, header, links, words, refusal):
    path = write(tmp_path, header + "\n" + ",".join("1" * (header.count(",") + 1)) + "\n")
    assert words in refusal(read_trace, path, links)


SWINGS = np.sin(np.arange(20.0))[:, None] * [1.0, 0.5]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"theta": np.zeros(20)}, r"x: theta has shape \(20,\); allowed: \(20, links\)"),
        ({"theta": np.zeros((19, 2))}, r"x: theta has shape \(19, 2\)"),
        ({"theta": np.zeros((20, 0))}, "x: theta has no columns; allowed: one for each link"),
        ({"theta": [[0.0, 1.0]] * 19 + [[0.0]]}, "x: t, theta and se are not arrays of numbers"),
        ({"se": np.ones(20)}, r"x: se has shape \(20,\); allowed: \(20, 2\)"),
        ({"t": -np.arange(20.0)}, "x: t: decreases from row to row"),
        ({"t": np.where(np.arange(20) == 3, np.nan, np.arange(20.0))}, "x: t: row 4 is missing"),
        ({"t": np.zeros(0), "theta": np.zeros((0, 2))}, "x: theta_1: every sample is missing"),
        ({"theta": np.zeros((20, 2)) + 0j}, "x: t, theta and se are not arrays of numbers"),
        ({}, "x: theta: is constant"),
        ({"theta": SWINGS, "se": -np.ones((20, 2))}, "x: se: -1 is not positive"),
        ({"theta": SWINGS, "convention": Convention("up")}, "x: zero = 'up' is unknown"),
        ({"theta": SWINGS, "model_error": np.nan}, "x: model_error = nan: not an angle"),
    ],
)
def test_a_trace_in_memory_that_cannot_be_fitted_is_refused(change, words):
    given = {"t": np.arange(20.0), "theta": np.zeros((20, 2))} | change
    with pytest.raises(SceneError, match=words):
        as_trace(Trace("x", **given), 2)


def test_a_trace_of_lists_has_arrays_in_which_infinite_samples_are_missing():
    theta = [*SWINGS.tolist()[:-1], [np.inf, 0.1]]
    trace = as_trace(Trace("x", list(range(20)), theta, se=[[1.0, 1.0]] * 20), 2)
    np.testing.assert_array_equal(trace.theta[19], [np.nan, 0.1])
    assert trace.total_error.shape == (20, 2)


def test_a_link_is_named_by_its_own_column_where_others_show_nothing():
    theta = np.sin(np.arange(40.0))[:, None] * np.ones(4)
    theta[:, 0] = np.nan
    theta[5:, 2] = np.nan
    trace = Trace("x", np.arange(40.0), theta)
    with pytest.raises(SceneError, match="x: theta_3: 5 samples"):
        check_trace(trace, partial=True)
    theta[:, 2] = theta[:, 1]
    theta[::5, 3] = -999.0
    with pytest.raises(SceneError, match="x: theta_4: -999 in 8 rows"):
        check_trace(trace, partial=True)
    with pytest.raises(SceneError, match="x: theta has no columns"):
        check_trace(Trace("x", np.arange(40.0), np.zeros((40, 0))))


@pytest.mark.parametrize("width", [5, 11, 49])
def test_smoothed_angles_and_rates_are_those_of_scipy(width):
    theta = np.random.default_rng(0).standard_normal((50, 3))
    angles, rates = smooth(theta, width, 0.02)
    np.testing.assert_allclose(angles, savgol_filter(theta, width, DEGREE, axis=0), atol=1e-11)
    expected = savgol_filter(theta, width, DEGREE, deriv=1, delta=0.02, axis=0)
    np.testing.assert_allclose(rates, expected, atol=1e-10)


def test_links_of_a_simulated_truth_keep_their_lengths_where_their_end_moves(chain):
    start = {"kind": "angles", "zero": "down", "polar": [0.3, 0.3]}
    moved = [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.1, 0.0, 0.0]]
    motion = {"point": "left", "time": [0.0, 0.25, 0.5], "displacement": moved}
    scene = chain([0.2, 0.1], [0.1, 0.1], start, effects={"weight": {}, "end_motion": motion})
    nodes = simulate_truth(scene, 0.5, 20.0).nodes
    lengths = np.linalg.norm(np.diff(nodes, axis=1), axis=2)
    np.testing.assert_allclose(lengths, np.broadcast_to([0.2, 0.1], lengths.shape), rtol=1e-9)


def test_links_of_a_trace_count_from_one_as_the_columns_of_its_file():
    trace = Trace("film", np.arange(3.0), np.zeros((3, 2)))
    assert [trace.column_name(j) for j in range(2)] == ["film link 1", "film link 2"]
