"""The release of the lab dropper by SciPy: accelerations in NumPy, node by node."""

import numpy as np
from scipy.integrate import solve_ivp

LENGTH = np.array([0.1040, 0.1061, 0.1040, 0.1061, 0.1040, 0.1061, 0.1040])
MASS = np.array([0.0324, 0.0334, 0.0324, 0.0334, 0.0324, 0.0334])
ENDS = np.array([[0.0, 0.0, 0.0], [0.28, 0.0, 0.0]])


def links(r):
    return np.diff(np.concatenate([ENDS[:1], r, ENDS[1:]]), axis=0)


def acceleration(r, v, b_l, b_q):
    """M a = F + G' T with T from |d|' ' = 0, G a = -|d'|^2: the equations as an ODE, in NumPy, node by node."""
    force = -b_l * v - b_q * np.linalg.norm(v, axis=1, keepdims=True) * v
    force[:, 2] -= 9.81 * MASS
    d = links(r)
    rate = np.diff(np.concatenate([np.zeros((1, 3)), v, np.zeros((1, 3))]), axis=0)
    g = np.zeros((7, 6, 3))
    for j in range(7):
        if j < 6:
            g[j, j] = d[j]
        if j > 0:
            g[j, j - 1] = -d[j]
    g = g.reshape(7, 18)
    inverse = np.repeat(1 / MASS, 3)
    lagrange = np.linalg.solve(g * inverse @ g.T, -np.sum(rate**2, axis=1) - g * inverse @ force.ravel())
    return (inverse * (force.ravel() + g.T @ lagrange)).reshape(6, 3)


def release(places, b_l, b_q, times):
    """Free nodes (k, 6, 3) at the times of a dropper let go at these places, by DOP853."""

    def slope(t, y):
        r, v = y.reshape(2, 6, 3)
        return np.concatenate([v, acceleration(r, v, b_l, b_q)]).ravel()

    begin = np.concatenate([np.asarray(places), np.zeros((6, 3))]).ravel()
    found = solve_ivp(slope, (0, times[-1]), begin, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-13)
    r = found.y.T.reshape(-1, 2, 6, 3)[:, 0]
    assert max(np.max(np.abs(np.linalg.norm(links(x), axis=1) - LENGTH)) for x in r) < 1e-9
    return r
