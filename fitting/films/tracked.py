"""The result of tracking a video."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropper_jax.base.json_values import jsonable
from fitting.films.calibration import Lens
from fitting.films.detection import MarkerAppearance
from fitting.films.lengths import detected_links, length_statistics
from fitting.films.marks import Marks
from fitting.traces.trace import Trace


@dataclass(frozen=True)
class Tracked:
    """Result of tracking a video.

    Attributes:
        trace: angles [rad] and standard errors, empty if a marker was not detected or a frame is marked.
        pixels: (k, n, 2) positions in the video's own pixels, bridged if not detected.
        metres: (k, n, 2) right and up of the first frame's node 0 [m]; pixels if no scale was given.
        detected: (k, n).
        appearance, lens, scaled: appearance of a marker, the lens or None, whether metres are metres.
        first_frame: of the video, that of the trace's first sample.
        fps [1/s]; status: `ok`, `not_converged` (the trace ends early) or `lost` (the circles do not move as the nodes
            of a chain), with the reason in `message`.
        marks: frames in which nodes swapped, jumped, or violated their links' lengths.
        slant: pan and pitch of the camera [rad] found from the motion, or None with a board in the plane.
        exposure: [s] estimated from the lengths of turning links, 0.7 to 1 of the shutter's (`exposure`); its effect is
            corrected. 0 if it is too short.
    """

    trace: Trace
    pixels: np.ndarray
    metres: np.ndarray
    detected: np.ndarray
    appearance: MarkerAppearance
    lens: Lens | None
    scaled: bool
    first_frame: int
    fps: float
    status: str
    message: str
    warnings: tuple[str, ...]
    marks: Marks
    slant: tuple[float, float] | None = None
    exposure: float = 0.0

    @property
    def link_lengths(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (n - 1,) of the links' measured lengths."""
        return length_statistics(self.metres, detected_links(self.detected) & ~self.marks.links)

    def to_json(self) -> dict[str, Any]:
        """The result without its samples."""
        mean, deviation = self.link_lengths
        angle_se_rad = None
        if self.trace.se is not None and np.isfinite(self.trace.se).any():
            angle_se_rad = np.nanmedian(self.trace.se)
        found = {
            "schema": 1,
            "status": self.status,
            "frames": len(self.detected),
            "fps": self.fps,
            "nodes": self.detected.shape[1],
            "links": self.detected.shape[1] - 1,
            "bridged": (~self.detected).sum(axis=0),
            "longest_gap_s": longest_gaps(self.detected).max() / self.fps,
            "angle_se_rad": angle_se_rad,
            "marker_radius_pixel": self.appearance.radius,
            "link_length_m": None,
            "link_length_deviation": deviation / mean,
            "marked": self.marks.spans(self.trace.t),
            "marked_frames": self.marks.frames.sum(),
            "slant_rad": self.slant,
            "exposure_s": self.exposure,
            "reprojection_error_pixel": None,
            "warnings": self.warnings,
        }
        if self.scaled:
            found["link_length_m"] = mean
        if self.lens is not None:
            found["reprojection_error_pixel"] = self.lens.error
        if self.status != "ok":
            found["error"] = self.message
        return jsonable(found)


def longest_gaps(detected: np.ndarray) -> np.ndarray:
    """Longest run of frames without a detection of each node (n,)."""
    known = np.pad(detected, ((1, 1), (0, 0)), constant_values=True)
    return np.array([np.diff(np.flatnonzero(column)).max() - 1 for column in known.T])
