"""Whitened residuals have the quadratic form and the determinant of the covariance that they are said to have."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Trace
from fitting.estimate.blocks import TimePieces, correlation_time, resample
from fitting.estimate.factors import Factor
from fitting.estimate.noise import Noise
from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.solution import Solution
from fitting.estimate.whitening import log_volume, whiten
from fitting.estimate.windows import Windows

SIGMA, STEP, SLOTS = np.array([0.004, 0.01]), 0.02, 40


def windows_of(theta, weight, **others):
    """Windows of the same slots, one after another."""
    count, slots, _ = theta.shape
    row = np.arange(count)
    return Windows(
        begin=STEP * slots * row, run=np.zeros(count, int), follows=row > 0, theta=theta, weight=weight,
        index=np.tile(np.arange(slots), (count, 1)), fraction=np.zeros((count, slots)), dt=STEP, steps=slots,
        released=np.zeros(count, bool), step_counts=np.full(count, slots), **others,
    )  # fmt: skip


@pytest.fixture
def windows():
    """One window of two links, some samples missing."""
    known = np.random.default_rng(0).random((1, SLOTS, 2)) > 0.25
    return windows_of(np.zeros((1, SLOTS, 2)), known / SIGMA)


def evaluated(windows, seed=1):
    rng = np.random.default_rng(seed)
    known = windows.weight > 0
    residual = np.where(known, rng.standard_normal(known.shape), 0.0)
    jacobian = np.where(known[..., None], rng.standard_normal((*known.shape, 3)), 0.0)
    return Evaluation(None, residual, jacobian, *[None] * 5)


def check(windows, covariance):
    """Against the dense covariance of all samples in units of their deviation, in the order of the array."""
    e, known = evaluated(windows), (windows.weight > 0).ravel()
    u = whiten(windows, e)
    r, J = e.residual.ravel()[known], e.jacobian.reshape(-1, 3)[known]
    exact = np.linalg.inv(covariance[np.ix_(known, known)])
    v, K = u.residual.ravel(), u.jacobian.reshape(-1, 3)
    assert v @ v == pytest.approx(r @ exact @ r, rel=1e-10)
    np.testing.assert_allclose(K.T @ v, J.T @ exact @ r, atol=1e-9)
    np.testing.assert_allclose(K.T @ K, J.T @ exact @ J, atol=1e-9)
    size = np.tile(SIGMA, SLOTS)[known]
    full = covariance[np.ix_(known, known)] * np.outer(size, size)
    assert log_volume(windows) == pytest.approx(np.linalg.slogdet(full)[1], rel=1e-10)


def test_noise_with_memory_and_gaps_is_whitened_exactly(windows):
    decay = np.array([[6.0, 30.0]])
    t = np.repeat(STEP * np.arange(SLOTS), 2)
    link = np.tile([0, 1], SLOTS)
    same = link[:, None] == link[None]
    check(replace(windows, decay=decay), same * np.exp(-decay[0, link] * np.abs(t[:, None] - t[None])))


def test_a_delay_common_to_a_frame_is_whitened_exactly(windows):
    jitter = np.random.default_rng(2).standard_normal((1, SLOTS, 2)) * 2
    frame = np.repeat(np.arange(SLOTS), 2)
    b = np.where(windows.weight > 0, jitter, 0.0).ravel()
    together = (frame[:, None] == frame[None]) * np.outer(b, b)
    check(replace(windows, jitter=jitter), np.eye(2 * SLOTS) + together)


def test_delays_move_the_mean_of_an_angle_by_half_their_square_times_its_acceleration():
    slots, speed, delay = 20_000, 8.0, 0.01
    t = STEP * np.arange(slots)
    late = delay * np.random.default_rng(3).standard_normal(slots)
    theta, acceleration = np.cos(speed * (t + late))[None, :, None], -(speed**2) * np.cos(speed * t)
    seen = windows_of(theta, np.ones((1, slots, 1)))
    noise = Noise(np.ones((1, 1)), np.full((1, 1), np.inf), np.array([delay]))
    shifts = [
        float((w.theta[0, :, 0] - np.cos(speed * t)) @ acceleration / (acceleration @ acceleration))
        for w in (seen, noise.apply_to(seen, [Trace("run", t, theta[0])]))
    ]
    assert shifts[0] == pytest.approx(0.5 * delay**2, rel=0.5)  # the delays are random: a standard error of a quarter
    assert shifts[0] - shifts[1] == pytest.approx(0.5 * delay**2, rel=0.02)


def test_windows_in_a_row_determine_a_constant_no_better_than_the_run_they_were_cut_from():
    """The exact information of a mean in AR(1) noise is `1' V^-1 1`; ten windows lose less than a hundredth of it."""
    count, phi = 10, 0.9
    shape = (count, SLOTS, 1)
    decay = np.full((count, 1), -np.log(phi) / STEP)
    row = windows_of(np.zeros(shape), np.ones(shape), decay=decay)
    u = whiten(row, Evaluation(None, np.ones(shape), np.ones((*shape, 1)), *[None] * 5)).residual
    place = np.arange(count * SLOTS)
    exact = np.linalg.inv(phi ** np.abs(place[:, None] - place[None])).sum()
    assert np.sum(u**2) == pytest.approx(exact, rel=0.01)


def test_memory_of_a_series_is_its_integrated_correlation_time():
    """AR(1) of correlation 0.8: (1 + 0.8)/(1 - 0.8) = 9; white noise 1."""
    rng = np.random.default_rng(3)
    white = rng.standard_normal(40_000)
    kept = np.zeros_like(white)
    for i in range(1, len(white)):
        kept[i] = 0.8 * kept[i - 1] + white[i]
    run = np.zeros(len(white), int)
    assert correlation_time(kept, run) == pytest.approx(9, rel=0.15)
    assert correlation_time(white, run) == pytest.approx(1, abs=0.1)


def test_the_diagonal_of_a_block_tridiagonal_inverse_is_that_of_the_dense_one():
    rng = np.random.default_rng(4)
    below = rng.standard_normal((4, 3, 3))
    dense = np.zeros((15, 15))
    for k in range(5):
        dense[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = 20 * np.eye(3) + np.diag(rng.random(3))
    for k in range(4):
        dense[3 * k + 3 : 3 * k + 6, 3 * k : 3 * k + 3] = below[k]
        dense[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6] = below[k].T
    blocks = lambda a: np.array([a[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(5)])  # noqa: E731
    found = Factor(blocks(dense), below).inverse_diagonal()
    np.testing.assert_allclose(found, blocks(np.linalg.inv(dense)), atol=1e-14)


def test_the_error_of_a_solution_is_in_radians_with_any_noise(windows):
    theta = 0.3 * np.random.default_rng(6).standard_normal(windows.theta.shape)
    with_memory = replace(windows, decay=np.array([[5.0, 5.0]]))
    point = SimpleNamespace(windows=with_memory, evaluation=SimpleNamespace(theta=theta))
    expected = np.where(windows.known, theta, 0.0)
    np.testing.assert_allclose(Solution.errors.fget(point), expected)


@pytest.mark.check
@pytest.mark.parametrize("shares", [[1.0] * 8, [6, 4, 3, 2, 2, 1, 1, 1]])
def test_the_bootstrap_of_eight_blocks_is_as_wide_as_estimates_scatter(shares):
    """Least squares of two coefficients to 1500 draws of noise; blocks of the same and of unlike information."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((8, 30, 2)) * np.sqrt(shares)[:, None, None]
    square = np.einsum("bsi,bsj->bij", x, x)
    information, truth = square.sum(axis=0), np.array([1.0, -2.0])
    values, widths = [], []
    for _ in range(1500):
        y = x @ truth + rng.standard_normal((8, 30))
        p = np.linalg.solve(information, np.einsum("bsi,bs->i", x, y))
        parts = TimePieces(np.einsum("bsi,bs->bi", x, x @ p - y), square, np.zeros(8, int))
        moved, blocks = resample(parts, information, 1, 100, rng)
        values.append(p)
        widths.append(moved.var(axis=0))
    ratio = np.sqrt(np.mean(widths, axis=0)) / np.std(values, axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.1)
    assert blocks == pytest.approx(
        8 if len(set(shares)) == 1 else np.sum(shares) ** 2 / np.sum(np.square(shares)), rel=0.3
    )
