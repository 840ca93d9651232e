"""Reading and writing videos with OpenCV (extra `video`)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import remove_leftovers, unfinished_folder

if TYPE_CHECKING:
    import cv2

#: Writers by suffix: lossless for measurements, MPEG-4 for viewing.
CODECS = {".avi": "FFV1", ".mp4": "mp4v"}


def opencv() -> ModuleType:
    """The module cv2 without its own output: errors of a file are reported in one line.

    Raises:
        SceneError: it is not installed.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    try:
        import cv2
    except ImportError:
        raise SceneError("video: needs OpenCV. Install it with: pip install 'dropper-jax[video]'") from None
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2


def read_image(path: str | Path) -> np.ndarray:
    """A grey image (height, width) of bytes.

    Raises:
        SceneError: no image there.
    """
    cv2 = opencv()
    if not Path(path).is_file():
        raise SceneError(f"{Path(path).name}: no such image; allowed: an existing file")
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SceneError(f"{Path(path).name}: cannot be read as an image; allowed: PNG, JPEG, TIFF, BMP")
    return image


class Video:
    """A video file, its frames in order as grey images.

    Attributes:
        path, fps [1/s], size: (width, height) [pixel].
        announced: frames announced by the file, 0 if unknown.

    Raises:
        SceneError: not a video, no frames, or no frame rate.
    """

    def __init__(self, path: str | Path, fps: float | None = None) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise SceneError(f"{self.path.name}: no such video; allowed: an existing file")
        cv2 = opencv()
        capture = self._open()
        _, frame = capture.read()  # of a damaged film it may be None though called good
        self.announced = int(max(0, capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        self.fps = float(fps or capture.get(cv2.CAP_PROP_FPS))
        capture.release()
        if frame is None:
            raise SceneError(
                f"{self.path.name}: has no frame that can be read; allowed: a video such as MP4, AVI or MOV"
            )
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise SceneError(f"{self.path.name}: has no frame rate. Use --fps FRAMES_PER_SECOND")
        self.size = (frame.shape[1], frame.shape[0])

    def _open(self) -> cv2.VideoCapture:
        """The file, opened at its first frame.

        Raises:
            SceneError: not a video.
        """
        capture = opencv().VideoCapture(str(self.path))
        if not capture.isOpened():
            raise SceneError(f"{self.path.name}: cannot be read as a video; allowed: a video such as MP4, AVI or MOV")
        return capture

    def frames(self, first: int = 0, last: int | None = None) -> Iterator[np.ndarray]:
        """Grey frames first <= i < last, each (height, width)."""
        cv2 = opencv()
        capture = self._open()
        try:
            for i in count():
                if i == last or not capture.grab():
                    return
                if i >= first:
                    _, frame = capture.retrieve()
                    if frame is None:
                        return
                    if frame.ndim == 3:
                        frame = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
                    yield frame
        finally:
            capture.release()


def write_video(path: str | Path, frames: Iterable[np.ndarray], fps: float) -> Path:
    """Write grey or colour frames of bytes; `.avi` is lossless, `.mp4` small.

    Raises:
        SceneError: another suffix, or no writer for it on this machine.
    """
    cv2 = opencv()
    path = Path(path)
    if path.suffix.lower() not in CODECS:
        raise SceneError(f"{path.name}: has no known suffix; allowed: {', '.join(CODECS)}")
    code = cv2.VideoWriter_fourcc(*CODECS[path.suffix.lower()])
    writer = None
    remove_leftovers(path)
    with unfinished_folder(path) as folder:
        part = folder / f"film{path.suffix}"
        for frame in frames:
            if frame.ndim == 2:
                frame = cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR)
            if writer is None:
                writer = cv2.VideoWriter(str(part), code, fps, (frame.shape[1], frame.shape[0]))
                if not writer.isOpened():
                    raise SceneError(f"{path.name}: OpenCV cannot write this kind here. Use another suffix")
            writer.write(frame)
        if writer is None:
            raise SceneError(f"{path.name}: there is no frame to write; allowed: at least one")
        writer.release()
        os.replace(part, path)
    return path


def spread_out(count: int, most: int) -> np.ndarray:
    """At most `most` of the numbers of `count` frames, spread evenly from the first to the last."""
    return np.unique(np.linspace(0, count - 1, most).astype(int))[:count]
