"""Files of other programs: cells, columns, clock and unit are found, or what is missing is named in one line."""

import re

import numpy as np
import pytest
from written_files import DAMPING, LENGTH, RATE, double_pendulum, points, swing, write

from dropper_jax import SceneError
from fitting.from_file.angle_unit import unit_of_angle
from fitting.from_file.cells import read_cells
from fitting.from_file.columns import find_columns
from fitting.from_file.fitted_values import per_mass
from fitting.from_file.pendulum import main_period
from fitting.from_file.pivot import error_of_pivot, pivot_of
from fitting.from_file.points import find_chain
from fitting.from_file.propose_scene import propose_scene
from fitting.from_file.read_file import NO_OPTIONS, FileOptions, read_measured
from fitting.traces.noise import without_spikes
from fitting.traces.text_lines import LARGEST_FILE
from fitting.traces.trace import Trace

T, PHI = swing()


@pytest.fixture
def read(tmp_path):
    """`read(head, columns, given)`: a file of columns (k,) below a header, as a trace."""

    def call(head, columns, given=NO_OPTIONS, **form):
        return read_measured(write(tmp_path / "a.csv", [head], np.stack(columns, axis=1), **form), given)

    return call


def length_of(found):
    return 9.81 / found.swing.stiffness


@pytest.mark.parametrize(
    ("head", "times", "angle", "separator", "comma", "unit"),
    [
        ("Zeit [ms];Winkel [°]", 1e3 * T, np.degrees(PHI), ";", True, "deg"),
        ("temps\tángulo", T, PHI, "\t", False, "rad"),
        ("timestamp,encoder", T, np.degrees(PHI) % 360, ",", False, "deg"),
        ("czas kąt", T, PHI + 1.57, "  ", False, "rad"),
        ("t;theta_mrad", T, 1e3 * PHI, ";", False, "mrad"),
        ("ch0,ch1", 1e3 * T, PHI, ",", False, "rad"),
        ("timestamp,ch1", 1e9 * (1.7e9 + T), PHI, ",", False, "rad"),
        ("Zeit / s;phi / rad", T, PHI, ";", True, "rad"),
    ],
)
def test_headers_units_and_decimals_give_the_same_trace(read, head, times, angle, separator, comma, unit):
    found = read(head, [times, angle], separator=separator, comma=comma)
    assert any(f"angle in {unit}" in note for note in found.notes)
    assert length_of(found) == pytest.approx(LENGTH, rel=0.01)
    assert found.swing.damping == pytest.approx(DAMPING, rel=0.1)
    there = np.interp(found.trace.t, T, PHI)
    # the mean of the rows of a sample lies on the motion
    assert np.abs(found.trace.theta[:, 0] - there).max() < 0.01


@pytest.mark.parametrize(("unit", "size"), [("rad", 1.0), ("deg", 57.29578)])
def test_unit_of_angle_follows_from_the_period_without_a_name(read, unit, size):
    assert any(f"angle in {unit}" in note for note in read("t,signal", [T, size * PHI]).notes)


def test_a_small_noisy_swing_of_some_degrees_is_no_swing_of_as_many_radians():
    """5.7 rad would be beyond the upright; the noise hides how the period grows."""
    t, phi = swing(8.0, start=0.1)
    noisy = np.degrees(phi) + 2.0 * np.random.default_rng(0).standard_normal(len(t))
    assert unit_of_angle(t, noisy, main_period(t, noisy[:, None])) == ("deg", 0.0)


def test_a_unit_that_the_period_contradicts_is_noted(read):
    note = "angle in deg, but the period grows with the amplitude as in rad: check the unit, --unit rad"
    assert note in read("t,signal", [T, PHI], FileOptions(unit="deg")).notes
    assert "angle in rad" in read("t,signal", [T, PHI], FileOptions(unit="rad")).notes


def test_a_repeated_a_swapped_and_a_restarted_row_are_reported(tmp_path):
    rows = np.stack([T, PHI], axis=1)
    rows = np.insert(rows, 500, rows[500], axis=0)
    rows[[700, 702]] = rows[[702, 700]]
    found = read_measured(write(tmp_path / "a.csv", ["t,angle_rad"], np.concatenate([rows, rows[:200]])))
    text = "; ".join(found.notes)
    assert "repeat a time" in text
    assert "sorted" in text
    assert "start again" in text


@pytest.mark.parametrize("start", ["held", "driven"])
def test_a_held_and_a_driven_start_are_left_out(read, start):
    before = np.arange(0.0, 2.0, 1 / RATE)
    hand = 0.9 + 0.003 * np.sin(9 * before)
    if start == "driven":
        hand = 0.9 * np.cos(2 * np.pi * (2.0 - before) / 0.7)
    found = read("t,angle_rad", [np.concatenate([before, 2.0 + T]), np.concatenate([hand, PHI])])
    assert 2.0 <= found.trace.t[0] < 3.3
    assert any("left out" in note for note in found.notes)


@pytest.mark.parametrize("step", [0.004, 0.0015], ids=["one step at a time", "three while it is fast"])
def test_a_log_of_an_encoders_steps_is_read_between_its_readings(read, step):
    rate = 2000.0
    t, phi = swing(25.0, rate=rate)
    count = np.round((phi + 0.02) / step)
    rows = np.flatnonzero(np.diff(count)) + 1
    found = read("t,angle", [t[rows], count[rows] * step])
    assert any("step of the encoder" in note for note in found.notes)
    assert found.zero == pytest.approx(0.02, abs=5e-4)
    earlier = found.trace.t - 0.5 / rate  # a change is seen half an interval late
    off = found.trace.theta[:, 0] + found.zero - 0.02 - np.interp(earlier, t, phi)
    assert np.sqrt(np.mean(off**2)) < 0.3 * step  # as read it leads by half a step


def test_a_coarse_encoder_without_noise_is_read_at_its_changes(read):
    t, phi = swing(25.0, rate=1000.0)
    step = 0.04
    found = read("t,angle", [t, step * np.round((phi + 0.013) / step)])
    assert any("read where it changes" in note for note in found.notes)
    off = found.trace.theta[:, 0] + found.zero - 0.013 - np.interp(found.trace.t, t, phi)
    assert np.sqrt(np.mean(off**2)) < 0.05 * step  # of a row: 0.29


def test_a_reading_that_repeats_has_no_spikes(tmp_path):
    """Where it is held, neighbours are equal; later they differ by a step, which is none."""
    step = 0.0026
    held = np.full(300, PHI[0])
    angle = step * np.round(np.r_[held, PHI] / step)
    trace = Trace("a", np.arange(len(angle)) / RATE, angle[:, None])
    assert np.isfinite(without_spikes(trace).theta).all()


@pytest.mark.parametrize(("rows", "noise"), [(30000, 0.03), (30000, 0.0), (1500, 0.03)])
def test_noise_of_a_fast_log_does_not_hide_its_period(rows, noise):
    """Differences of neighbours grow with the rate of the rows."""
    t = np.linspace(0.0, 45.0, rows)
    random = np.random.default_rng(0)
    angle = 0.6 * np.exp(-0.05 * t) * np.cos(7.0 * t) + noise * random.standard_normal(rows)
    assert main_period(t, angle[:, None]) == pytest.approx(2 * np.pi / 7.0, rel=5e-3)


@pytest.mark.parametrize(("begin", "rows"), [(9.95, 50), (9.9, 100)])
def test_the_end_of_a_fast_log_keeps_its_rows_where_few_means_would_remain(read, begin, rows):
    t = np.arange(10000) / 1000
    file = "t,angle 1 [rad],angle 2 [rad]", [t, 0.5 * np.sin(4 * t), 0.4 * np.sin(4 * t + 0.3)]
    whole = read(*file, FileOptions(lengths=(0.3, 0.3)))
    assert len(whole.trace.t) < 1000
    found = read(*file, FileOptions(lengths=(0.3, 0.3), begin=begin))
    assert len(found.trace.t) == rows
    assert not any("thinned" in note for note in found.notes)


def test_a_swing_that_a_hand_ends_is_cut_out_by_the_end_of_the_span(read, refusal):
    """Pushed again and again after the swing, for three times as long."""
    after = np.arange(T[-1] + 1 / RATE, 4 * T[-1], 1 / RATE)
    columns = [np.concatenate([T, after]), np.concatenate([PHI, 0.5 * np.sin(2.0 * after) ** 3])]
    assert "cut it out: --from, --until" in refusal(read, "t,angle_rad", columns)
    found = read("t,angle_rad", columns, FileOptions(end=T[-1]))
    assert length_of(found) == pytest.approx(LENGTH, rel=0.01)
    assert "9 rows before --until 0.09 s" in refusal(read, "t,angle_rad", columns, FileOptions(end=0.09))


def test_frames_need_a_rate_and_a_comment_gives_it(read):
    columns = [np.arange(len(T)), PHI]
    with pytest.raises(SceneError, match=r"--rate 60"):
        read("frame,angle_rad", columns)
    for found in (
        read("frame,angle_rad", columns, FileOptions(rate=RATE)),
        read("# fps: 100\nframe,angle_rad", columns),
        read("angle_rad", [PHI], FileOptions(rate=RATE)),
    ):
        assert length_of(found) == pytest.approx(LENGTH, rel=0.01)


@pytest.mark.parametrize("arms", [(0.7,), (0.1, 0.35)], ids=["a point", "two points of a link"])
def test_one_point_and_two_points_of_a_link_give_its_angle(read, arms):
    ends = [2 + 1j - 1j * arm * np.exp(1j * PHI) for arm in arms]
    found = read(",".join(["t", "x1", "y1", "x2", "y2"][: 1 + 2 * len(arms)]), [T, *points(*ends)])
    assert length_of(found) == pytest.approx(LENGTH, rel=0.01)


@pytest.mark.parametrize("unit", ["m", "mm", "px"])
def test_gravity_gives_the_points_of_a_chain_their_scale(read, unit):
    t, first, second = double_pendulum()
    size = {"m": 1.0, "mm": 1e-3, "px": 4.3e-4}[unit]
    ends = np.array([0.2 * first, 0.2 * first + 0.15 * second]) / size
    if unit == "px":  # downwards
        ends = ends.conj()
    found = read("t;A x;A y;B x;B y", [t, *points(*ends, noise=2e-4 / size)], separator=";")
    # without a unit it is a start value of the fit
    assert found.lengths == pytest.approx([0.2, 0.15], rel=0.06 if unit == "px" else 0.01)
    assert any("scaled by gravity" in note for note in found.notes) == (unit == "px")


def four_markers():
    """Times, and noisy columns of two points on each of two links."""
    t, first, second = double_pendulum()
    joint = 0.2 * first
    return t, np.array(points(0.05 * first, 0.15 * first, joint + 0.04 * second, joint + 0.12 * second))


@pytest.mark.parametrize(("frames", "found"), [(12, np.nan), (1, 1.0)])
def test_a_film_with_two_points_per_link_may_miss_one_or_see_two_as_one(read, frames, found):
    """Without a NumPy warning, which the tests turn into errors."""
    t, columns = four_markers()
    random = np.random.default_rng(0)
    for point in range(0, 8, 4):
        few = random.choice(len(t), frames, replace=False)
        columns[point : point + 2, few] = found * columns[point + 2 : point + 4, few]
    found = read("t,x1,y1,x2,y2,x3,y3,x4,y4", [t, *columns])
    assert np.isfinite(found.trace.theta).all(axis=1).sum() > 250
    assert found.lengths[0] / found.lengths[1] == pytest.approx(0.2 / 0.15, rel=0.06)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_pivot_of_points_that_coincide_in_some_frames_is_where_the_first_link_turns(seed):
    """A circle through such points has its centre hundreds of metres away."""
    t, columns = four_markers()
    markers = columns[::2] + 1j * columns[1::2]
    few = np.random.default_rng(seed).choice(len(t), 5, replace=False)
    markers[0, few] = markers[1, few]
    chain, _ = find_chain("film", markers, None)
    assert abs(chain.pivot) < 1e-3
    assert np.median(np.abs(chain.joints[1])) == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize("arms", [(0.3,), (0.1, 0.3)], ids=["a point", "two points of a link"])
def test_a_pivot_that_is_found_is_off_by_as_much_as_is_stated(arms):
    noise = 5e-4
    off = []
    for seed in range(40):
        random = np.random.default_rng(seed)
        seen = np.outer(arms, -1j * np.exp(1j * PHI))
        seen = seen + noise * (random.standard_normal(seen.shape) + 1j * random.standard_normal(seen.shape))
        pivot = pivot_of(seen[0], seen[1:], noise)
        off.append(np.array([pivot.real, pivot.imag]) / error_of_pivot(seen, -0.5 * np.pi))
    assert np.sqrt(np.mean(np.square(off), axis=0)) == pytest.approx(1.0, abs=0.3)


def driven():
    """An angle that a motor moves."""
    return 0.6 * np.sin(5.0 * T)


@pytest.mark.parametrize(
    ("head", "columns", "message"),
    [
        ("t,angle_rad", lambda: [T, np.zeros(len(T))], "nothing moves"),
        ("angle_rad", lambda: [PHI], "one column"),
        ("t,angle_rad", lambda: [T, driven()], "driven throughout"),
        ("t,s1,s2", lambda: [T, PHI, 0.5 * PHI**2], "--columns theta_1=s1"),
        ("t,encoder_counts", lambda: [T, np.round(1000 * PHI)], "--counts 4096"),
        ("t,angle 1 [rad],angle 2 [rad]", lambda: [T, PHI, np.roll(PHI, 30)], "--lengths L1,L2"),
        ("t,angle_rad", lambda: [T[::-1], PHI], "Reverse the rows"),
        ("Time (s),Gyroscope z (rad/s)", lambda: [T, np.gradient(PHI, T)], "shows rates alone: Gyroscope z (rad/s)"),
        ("t,swing (rad/s)", lambda: [T, np.gradient(PHI, T)], "shows rates alone: swing (rad/s)"),
        ("t,swing [rad s^-1]", lambda: [T, np.gradient(PHI, T)], "shows rates alone: swing [rad s^-1]"),
        ("t,s-1,s-2", lambda: [T, PHI, 0.5 * PHI**2], "--columns theta_1=s-1"),
        ("t,x [m/s],y [m/s]", lambda: [T, np.cos(PHI), np.sin(PHI)], "shows rates alone: x [m/s], y [m/s]"),
    ],
)
def test_what_is_missing_is_named_in_one_line(read, head, columns, message, refusal):
    assert message in refusal(read, head, columns())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"theta_1": "a", "x_1": "b", "y_1": "c"}, "theta_1, x_1, y_1; allowed: theta_1 to theta_n, or x_1, y_1 to"),
        ({"time": "t", "theta_2": "a"}, "columns: theta_2; allowed: theta_1 to theta_n"),
        ({"x_1": "a"}, "columns: point 1 needs both x_1 and y_1"),
    ],
)
def test_columns_that_the_user_names_are_all_angles_or_all_points_without_a_gap(read, refusal, given, message):
    columns = [T, PHI, np.cos(PHI), np.sin(PHI)]
    assert message in refusal(read, "t,a,b,c", columns, FileOptions(columns=given))


def test_binary_empty_and_huge_files_are_refused_in_one_line(tmp_path):
    (tmp_path / "binary.csv").write_bytes(b"PK\3\4\0\0" * 100)
    (tmp_path / "empty.csv").write_text("")
    with (tmp_path / "huge.csv").open("wb") as file:
        file.truncate(LARGEST_FILE + 1)
    for name, message in (("binary", "not text"), ("empty", "is empty"), ("huge", "allowed"), ("missing", "cannot be")):
        with pytest.raises(SceneError, match=message):
            read_cells(tmp_path / f"{name}.csv")


def test_two_rows_of_names_number_the_points(tmp_path):
    rows = np.stack([T, *points(np.exp(1j * PHI), 2 * np.exp(1j * PHI))], axis=1)
    path = write(tmp_path / "a.txt", ["\tmass_A\t\tmass_B\t", "t\tx\ty\tx\ty"], rows, "\t")
    found = find_columns(read_cells(path))
    assert found.time.name == "t"
    assert [(x.name, y.name) for x, y in found.points] == [("mass_A x", "mass_A y"), ("mass_B x", "mass_B y")]


@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_the_last_point_may_be_missing_in_the_first_row(tmp_path, separator):
    rows = np.stack([T, *points(np.exp(1j * PHI), 2 * np.exp(1j * PHI))], axis=1)
    path = write(tmp_path / "a.csv", [separator.join(["t", "x1", "y1", "x2", "y2"])], rows, separator)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[1] = separator.join([*lines[1].split(separator)[:3], "", ""])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    cells = read_cells(path)
    assert [(x.name, y.name) for x, y in find_columns(cells).points] == [("x1", "y1"), ("x2", "y2")]
    assert len(cells.values) == len(T)
    assert np.isnan(cells.values[0, 3:]).all()


def test_lengths_in_another_unit_are_refused(read):
    with pytest.raises(SceneError, match="Give metres"):
        read("t,angle_rad", [T, PHI], FileOptions(lengths=(1000 * LENGTH,)))
    found = read("t,angle_rad", [T, PHI], FileOptions(lengths=(LENGTH,)))
    assert any("effective length follows" in note for note in found.notes)


@pytest.mark.parametrize("turn", [256, 360, 1000, 2000, 4096])
def test_an_angle_that_wraps_is_read_by_its_full_turn(read, turn):
    t, phi = swing(start=1.5)
    reading = np.mod(turn * (phi / (2 * np.pi)), turn)
    if turn != 360:
        reading = np.floor(reading)
    found = read("t,reading", [t, reading])
    assert length_of(found) == pytest.approx(LENGTH, rel=0.02)
    assert np.abs(found.trace.theta[:, 0] - np.interp(found.trace.t, t, phi)).max() < 0.5 * 2 * np.pi / turn + 0.02


@pytest.mark.parametrize("more", [{}, {"theta_1": "angle_rad"}])
def test_a_column_of_times_that_the_user_names_is_used_whatever_the_others_are_called(tmp_path, more):
    rows = np.stack([T, T[::-1], PHI], axis=1)
    file = write(tmp_path / "a.csv", ["stamp,time left,angle_rad"], rows)
    columns = find_columns(read_cells(file), {"time": "stamp", **more})
    assert columns.time.name == "stamp"
    assert [column.name for column in columns.angles] == ["angle_rad"]


def test_links_are_in_the_order_of_their_numbers_not_of_their_digits(tmp_path):
    names = [f"a{i}" for i in range(1, 12)]
    rows = np.stack([T, *(i * PHI for i in range(1, 12))], axis=1)
    file = write(tmp_path / "a.csv", [",".join(["t", *names])], rows)
    given = {f"theta_{i + 1}": name for i, name in enumerate(names)}
    assert [column.name for column in find_columns(read_cells(file), given).angles] == names


@pytest.mark.parametrize("date", ["", "2026-11-30T", "11/30/2026 ", "30.11.2026 "])
def test_a_clock_that_passes_midnight_goes_on(tmp_path, date):
    seconds = 86395.0 + T
    lines = ["time;angle_rad"]
    for second, angle in zip(seconds, PHI, strict=True):
        minutes, rest = divmod(second % 86400, 60)
        hour, minute = divmod(int(minutes), 60)
        lines.append(f"{date}{hour:02d}:{minute:02d}:{rest:06.3f};{angle:.6f}")
    text = "\n".join(lines) + "\n"
    if date.startswith("30."):
        text = re.sub(r"(\d)\.(\d+)(?=[;\n])", r"\1,\2", text)  # decimal commas
    (tmp_path / "a.csv").write_text(text)
    np.testing.assert_allclose(read_cells(tmp_path / "a.csv").values[:, 0], seconds, atol=1e-3)


@pytest.mark.parametrize(
    ("unit", "dimension"),  # powers of kg, m and s
    [("kg/s", (1, 0, -1)), ("kg/m", (1, -1, 0)), ("N m", (1, 2, -2)), ("N m s/rad", (1, 2, -1)), ("N m^2", (1, 3, -2))],
)
def test_a_unit_per_mass_has_one_kilogram_less(unit, dimension):
    _, metres, seconds = dimension
    words = {"1/s": (0, -1), "1/m": (-1, 0), "m^2/s^2": (2, -2), "m^2/s": (2, -1), "m^3/s^2": (3, -2)}
    assert words[per_mass(unit)] == (metres, seconds)


def test_links_that_are_never_seen_in_one_row_start_where_they_are_at_its_time(tmp_path):
    t = T[::5]
    lines = ["t,angle 1 [rad],angle 2 [rad]"]
    for i, angle in enumerate(PHI[::5]):
        one, other = (f"{angle:.6f}", "") if i % 2 else ("", f"{2 * angle:.6f}")
        lines.append(f"{t[i]:.3f},{one},{other}")
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    given = FileOptions(lengths=(0.2, 0.2))
    start = propose_scene(read_measured(tmp_path / "a.csv", given), given)["start"]["polar"]
    np.testing.assert_allclose(start, [PHI[5], 2 * PHI[0]], atol=1e-5)
