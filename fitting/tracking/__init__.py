"""From a video of marked nodes to angle traces: the thesis' laboratory pipeline (section 7.3), made repeatable.

Lens (`calibration`), circles (`detection`), which circle is which node (`ordering`, `identity`), angles (`angles`), and
pictures to check all of it by eye (`overlay`). `render` makes videos of a simulated run, whose truth is known.
"""

from fitting.tracking.track import Tracked, track

__all__ = ["Tracked", "track"]
