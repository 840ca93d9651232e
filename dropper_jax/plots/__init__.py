"""Pictures of a solution, one call each: `snapshot(solution, "pose.png")`.

Files are written atomically, and global matplotlib settings are not changed. Pictures of a diverged run show the part
before the divergence.
"""

from dropper_jax.plots.angles import angle_traces, phase_space
from dropper_jax.plots.animation import animate
from dropper_jax.plots.energy import energy_balance
from dropper_jax.plots.link_response import response
from dropper_jax.plots.motion import body_motion, motion_history
from dropper_jax.plots.side_views import under_surface
from dropper_jax.plots.snapshots import snapshot
from dropper_jax.plots.spectra import amplitude_spectrum
from dropper_jax.plots.tension import tension_history
from dropper_jax.plots.tension_along import tension_envelope

__all__ = [
    "amplitude_spectrum",
    "angle_traces",
    "animate",
    "body_motion",
    "energy_balance",
    "motion_history",
    "phase_space",
    "response",
    "snapshot",
    "tension_envelope",
    "tension_history",
    "under_surface",
]
