"""From a video of marked nodes to angle traces: the thesis' laboratory pipeline (section 7.3), made repeatable.

The steps are the lens (`calibration`), circles (`detection`), identity of the nodes (`ordering`, `identity`), angles
(`link_angles`), and pictures for a visual check (`overlay`). `render` makes videos of a simulated run with known truth.
"""

from fitting.films.track import track
from fitting.films.tracked import Tracked

__all__ = ["Tracked", "track"]
