"""Amplitude spectra against hand-made signals."""

import numpy as np
import pytest

from dropper_jax.analysis import amplitude_spectrum

T = np.arange(2000) * 0.01  # 20 s: bins of 0.05 Hz


@pytest.mark.parametrize("window", ["hann", "none"])
def test_sines_on_bins_have_their_amplitudes(window):
    x = 3.0 + 0.7 * np.sin(2 * np.pi * 1.25 * T + 0.3) + 0.02 * np.cos(2 * np.pi * 4.0 * T)
    frequency, amplitude = amplitude_spectrum(T, x, window)
    assert frequency.shape == amplitude.shape == (1001,)
    np.testing.assert_allclose(amplitude[frequency.searchsorted(1.25 - 1e-6)], 0.7, rtol=1e-10)
    np.testing.assert_allclose(amplitude[frequency.searchsorted(4.0 - 1e-6)], 0.02, rtol=1e-10)
    assert amplitude[0] < 1e-12


@pytest.mark.parametrize(("window", "worst"), [("hann", 8 / (3 * np.pi)), ("none", 2 / np.pi)])
def test_a_sine_between_two_bins_loses_what_its_window_predicts(window, worst):
    # Half-way between bins the window's transform is 8/(3 pi) (Hann) or 2/pi (none) of its peak.
    frequency, amplitude = amplitude_spectrum(T, np.sin(2 * np.pi * 10.025 * T), window)
    np.testing.assert_allclose(amplitude.max(), worst, rtol=2e-3)
    assert abs(frequency[amplitude.argmax()] - 10.025) <= 0.025 + 1e-9


def test_nyquist_and_odd_lengths_have_the_right_scale():
    alternating = 0.5 * (-1.0) ** np.arange(64)
    frequency, amplitude = amplitude_spectrum(np.arange(64) * 0.1, alternating, "none")
    np.testing.assert_allclose(frequency[-1], 5.0)
    np.testing.assert_allclose(amplitude[-1], 0.5, rtol=1e-12)
    odd = np.arange(101) / 101
    np.testing.assert_allclose(amplitude_spectrum(odd, np.cos(2 * np.pi * 50 * odd))[1][-1], 1.0, rtol=0.55)
    np.testing.assert_allclose(amplitude_spectrum(odd, np.cos(2 * np.pi * 50 * odd), "none")[1][-1], 1.0, rtol=1e-10)


def test_columns_are_treated_alone():
    x = np.stack([np.sin(2 * np.pi * 2 * T), 5 * np.cos(2 * np.pi * 3 * T)], axis=1)
    _, both = amplitude_spectrum(T, x)
    for column in range(2):
        np.testing.assert_allclose(both[:, column], amplitude_spectrum(T, x[:, column])[1], atol=1e-15)


def test_single_precision_times_count_as_uniform():
    t = np.arange(5000) * 0.01  # 50 s: bins of 0.02 Hz
    frequency, amplitude = amplitude_spectrum(t.astype(np.float32), np.sin(2 * np.pi * 2 * t))
    assert frequency[np.argmax(amplitude)] == pytest.approx(2.0, rel=1e-6)
    assert np.max(amplitude) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(
    ("t", "x", "window", "word"),
    [
        (np.array([0.0, 0.1, 0.3]), np.zeros(3), "hann", "t: steps"),
        (np.array([0.0, -0.1, -0.2]), np.zeros(3), "hann", "t: steps"),
        (np.array([0.0]), np.zeros(1), "hann", "t: shape"),
        (np.array([0.0, np.nan]), np.zeros(2), "hann", "t: has"),
        (np.arange(3.0), np.zeros(4), "hann", "x: shape"),
        (np.arange(3.0), np.array([0, np.inf, 0]), "hann", "x: has"),
        (np.arange(3.0), np.zeros(3), "box", "window"),
    ],
)
def test_mistakes_name_the_argument(t, x, window, word):
    with pytest.raises(ValueError, match=f"^{word}"):
        amplitude_spectrum(t, x, window)
