"""Motions and text files for the tests of files of users."""

import numpy as np

LENGTH, DAMPING, RATE = 0.4, 0.08, 100.0


def swing(duration=25.0, start=0.9, rate=RATE):
    """Times and angles of a damped pendulum by Runge and Kutta's method."""

    def slope(y):
        return np.array([y[1], -9.81 / LENGTH * np.sin(y[0]) - DAMPING * y[1]])

    every = max(1, round(500 / rate))
    h = 1.0 / (rate * every)
    y = np.array([start, 0.0])
    found = []
    for i in range(int(duration * rate) * every):
        if i % every == 0:
            found.append(y[0])
        y = step(slope, y, h)
    return np.arange(len(found)) / rate, np.array(found)


def step(slope, y, h):
    """One step of Runge and Kutta's method."""
    k1 = slope(y)
    k2 = slope(y + h / 2 * k1)
    k3 = slope(y + h / 2 * k2)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(y + h * k3))


def write(path, head, rows, separator=",", comma=False, places=5):
    def cell(value):
        text = f"{value:.{places}f}"
        return text.replace(".", ",") if comma else text

    lines = [*head, *(separator.join(map(cell, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def points(*ends, noise=2e-4):
    """Columns of points (m, k) of complex numbers, with noise."""
    random = np.random.default_rng(1)
    columns = []
    for end in ends:
        for axis in (np.real(end), np.imag(end)):
            columns.append(axis + noise * random.standard_normal(len(axis)))
    return columns


def double_pendulum():
    """Times and directions (k,) of two links with point masses, as complex numbers, by Runge and Kutta's method."""
    one, two, share = 0.2, 0.15, 0.4

    def slope(y):
        a, b, u, v = y
        c, d = np.cos(a - b), np.sin(a - b)
        matrix = np.array([[one, share * two * c], [one * c, two]])
        right = [-share * two * d * v**2 - 9.81 * np.sin(a), one * d * u**2 - 9.81 * np.sin(b)]
        return np.array([u, v, *np.linalg.solve(matrix, right)])

    h, y, found = 1 / 600, np.array([0.9, -0.4, 0.0, 0.0]), []
    for i in range(3600):
        if i % 5 == 0:
            found.append(y[:2])
        y = step(slope, y, h)
    return np.arange(len(found)) / 120, *(-1j * np.exp(1j * np.transpose(found)))
