"""Positions of a tracked chain in metres, level, and the standard errors of its angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fitting.films.flat_map import central_differences
from fitting.films.link_angles import estimate_angle_errors, four_quadrant
from fitting.films.tracked_chain import TrackedChain


def scale_positions(chain: TrackedChain, scale: float | None, distance: float | None) -> np.ndarray:
    """Positions (k, n, 2), right and up, in m if a scale is known, otherwise in pixels."""
    flat = chain.flat * [1.0, -1.0]
    if chain.map.plane is not None:
        scale = chain.map.plane.metres_per_pixel(chain.map.middle)
    if distance is not None:
        scale = distance / float(np.median(np.linalg.norm(flat[:, -1] - flat[:, 0], axis=1)))
    if scale is None:
        return flat
    return flat * scale


def level_positions(metres: np.ndarray) -> np.ndarray:
    """The positions rotated so that the mean line from the first to the last node is level."""
    span = np.mean(metres[:, -1] - metres[:, 0], axis=0)
    if not np.hypot(*span) > 0:
        return metres
    # nearest level direction: the chain may run from right to left
    c, s = np.copysign(1.0, span[0]) * span / np.hypot(*span)
    return metres @ np.array([[c, -s], [s, c]])


def chain_angle_errors(chain: TrackedChain, used: np.ndarray, level: float) -> np.ndarray:
    """Standard errors (k, n - 1) [rad]: scatter, and the uncertainty of `level` and of the map to the plane."""
    found = np.hypot(estimate_angle_errors(chain.where_detected(chain.flat), chain.error, used), level)
    flat = chain.map
    if flat.parameters is None or flat.covariance is None:
        return found

    def angles(parameters: np.ndarray) -> np.ndarray:
        return four_quadrant(replace(flat, parameters=parameters)(chain.pixels))

    jacobian = central_differences(angles, flat.parameters, 1e-4)
    return np.sqrt(found**2 + np.einsum("kja,ab,kjb->kj", jacobian, flat.covariance, jacobian))
