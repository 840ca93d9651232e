"""Motion out of the plane, detected from links that seem to shorten in a way that no fixed camera explains.

A link that swings out of the plane by psi is seen with cos psi of its length. A slanting camera or a bending lens
also shortens links, but always by the same amount at the same position and direction:

    log l = a + (1, x, z) (b cos 2 theta + c sin 2 theta) + (x, z, x^2, x z, z^2) d + rest,

where theta is the link's angle and (x, z) its middle. The part of the rest that persists from frame to frame cannot
be noise of the marks: it is motion out of the plane.
"""

from __future__ import annotations

import numpy as np

from fitting.films.lengths import length_statistics

#: Relative standard deviation of a link's length that is reported as motion out of the plane: a swing of 0.1 rad.
OUT_OF_PLANE = 0.003
#: Relative standard deviation of a link's length that is reported where a camera may explain it.
CHANGING_LENGTH = 0.03
#: Minimum number of pairs of frames from which motion out of the plane is detected.
MIN_PAIRS = 30


def changing_lengths(flat: np.ndarray, used: np.ndarray) -> tuple[str, ...]:
    """A line if links change their lengths, which rigid ones in the plane of motion do not.

    Args:
        flat: positions (k, n, 2) in the plane of motion, in any unit.
        used: (k, n - 1), frames in which a link is detected.
    """
    away = out_of_plane(flat, used)
    worst = np.argmax(away)
    if away[worst] > OUT_OF_PLANE:
        return (
            f"motion out of the plane: link {worst + 1} seems to change its length by {100 * away[worst]:.2g} %, which "
            "a fixed camera cannot show for a motion in the plane",
        )
    mean, deviation = length_statistics(flat, used)
    change = np.nan_to_num(deviation / mean)
    worst = np.argmax(change)
    if change[worst] > CHANGING_LENGTH:
        return (
            f"link {worst + 1} changes its length by {100 * change[worst]:.2g} %: motion out of the plane, a slanting "
            "camera (--plane) or an uncalibrated lens (--calibration)",
        )
    return ()


def out_of_plane(flat: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Relative standard deviation of the links' lengths (n - 1,) due to motion out of the plane."""
    found = np.zeros(used.shape[1])
    for j in range(len(found)):
        link = np.diff(flat[:, j : j + 2], axis=1)[:, 0] @ [1.0, 1j]
        keep = used[:, j] & (link != 0)
        if keep.sum() < MIN_PAIRS:
            continue
        middle = flat[keep, j : j + 2].mean(axis=1)
        middle = middle - middle.mean(axis=0)
        x, z = (middle / max(np.abs(middle).max(), 1e-300)).T
        log = np.log(link[keep])
        basis = np.stack([np.ones_like(x), x, z])
        twice = 2 * log.imag
        columns = np.concatenate([basis, [x * x, x * z, z * z], basis * np.cos(twice), basis * np.sin(twice)]).T
        rest = np.full(len(keep), np.nan)
        rest[keep] = log.real - columns @ np.linalg.lstsq(columns, log.real, rcond=None)[0]
        pairs = rest[1:] * rest[:-1]
        pairs = pairs[np.isfinite(pairs)]
        if len(pairs) >= MIN_PAIRS:
            found[j] = np.sqrt(max(float(pairs.mean()), 0.0))
    return found
