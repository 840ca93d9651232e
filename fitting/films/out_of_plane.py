"""Motion out of the plane, detected from links that seem to shorten in a way that no fixed camera explains.

A link that swings out of the plane by psi is seen with cos psi of its length. A slanting camera or a bending lens
also shortens links, but always by the same amount at the same position and direction:

    log l = a + (1, x, z) (b cos 2 theta + c sin 2 theta) + (x, z, x^2, x z, z^2) d + rest,

where theta is the link's angle and (x, z) its middle. The part of the rest that persists from frame to frame cannot
be noise of the marks: it is motion out of the plane.
"""

from __future__ import annotations

import numpy as np

from fitting.films.flattening import link_lengths

#: Relative standard deviation of a link's length that is reported as motion out of the plane: a swing of 0.1 rad.
OUT_OF_PLANE = 0.003


def changing_lengths(flat: np.ndarray, used: np.ndarray) -> tuple[str, ...]:
    """A line if links change their lengths, which rigid ones in the plane of motion do not.

    Args:
        flat: positions (k, n, 2) in the plane of motion, in any unit.
        used: (k, n - 1), frames in which a link is detected.
    """
    away = out_of_plane(flat, used)
    worst = int(np.argmax(away))
    if away[worst] > OUT_OF_PLANE:
        return (
            f"motion out of the plane: link {worst + 1} seems to change its length by {100 * away[worst]:.2g} %, which "
            "a fixed camera cannot show for a motion in the plane",
        )
    known = [column[good] for column, good in zip(link_lengths(flat).T, used.T, strict=True)]
    change = np.array([np.std(column) / np.mean(column) if len(column) else 0.0 for column in known])
    worst = int(np.argmax(change))
    if change[worst] > 0.03:
        return (
            f"link {worst + 1} changes its length by {100 * change[worst]:.2g} %: motion out of the plane, a slanting "
            "camera (--plane) or an uncalibrated lens (--calibration)",
        )
    return ()


def out_of_plane(flat: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Relative standard deviation of the links' lengths (n - 1,) due to motion out of the plane."""
    # minimum number of pairs of frames from which motion out of the plane is detected
    fewest_pairs = 30
    length = link_lengths(flat)
    middle = 0.5 * (flat[:, 1:] + flat[:, :-1])
    along = np.diff(flat, axis=1)
    twice = 2 * np.arctan2(along[..., 1], along[..., 0])
    found = np.zeros(length.shape[1])
    for j in range(len(found)):
        keep = used[:, j] & (length[:, j] > 0)
        if keep.sum() < fewest_pairs:
            continue
        position = middle[keep, j] - middle[keep, j].mean(axis=0)
        x, z = (position / max(np.abs(position).max(), 1e-300)).T
        c = np.cos(twice[keep, j])
        s = np.sin(twice[keep, j])
        one = np.ones_like(x)
        products = [f * g for f in (one, x, z) for g in (c, s)]
        columns = np.stack([one, x, z, x * x, x * z, z * z, *products], axis=1)
        log_length = np.log(length[keep, j])
        rest = np.full(len(keep), np.nan)
        rest[keep] = log_length - columns @ np.linalg.lstsq(columns, log_length, rcond=None)[0]
        pairs = rest[1:] * rest[:-1]
        pairs = pairs[np.isfinite(pairs)]
        if len(pairs) >= fewest_pairs:
            found[j] = np.sqrt(max(float(pairs.mean()), 0.0))
    return found
