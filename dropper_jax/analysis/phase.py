"""Phase space of a link: its angle and its rate."""

from __future__ import annotations

import numpy as np

from dropper_jax.analysis.angles import angle_rates, link_angles

ANGLES = ("polar", "azimuth")


def phase_curve(
    positions: np.ndarray, velocities: np.ndarray, link: int = 0, zero: str = "horizontal", angle: str = "polar"
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and rate of one link along a motion.

    Args:
        positions, velocities: (k, n + 1, 3) [m], [m/s].
        link: which, 0 .. n - 1; negative counts from the last.
        zero: convention of the polar angle, see `link_angles`.
        angle: "polar" or "azimuth".

    Returns:
        angle (k,) [rad] and rate (k,) [rad/s].

    Raises:
        ValueError: no such link, another `zero` or `angle`.
    """
    if angle not in ANGLES:
        raise ValueError(f"angle = {angle!r}: must be one of {', '.join(ANGLES)}")
    positions, velocities = np.asarray(positions), np.asarray(velocities)
    links = positions.shape[1] - 1
    if not -links <= link < links:
        raise ValueError(f"link = {link}: must be from {-links} to {links - 1}")
    nodes = [link % links, link % links + 1]
    which = ANGLES.index(angle)
    values = link_angles(positions[:, nodes], zero)[which]
    rates = angle_rates(positions[:, nodes], velocities[:, nodes], zero)[which]
    return values[:, 0], rates[:, 0]
