"""Pictures of a solution, one call each: `snapshot(solution, "pose.png")`.

Files are written atomically, and global matplotlib settings are not changed. Pictures of a diverged run show the part
before the divergence.
"""

from dropper_jax.plots.animation import animate
from dropper_jax.plots.energy import energy_balance
from dropper_jax.plots.motion import amplitude_spectrum, angle_traces, motion_history, phase_space
from dropper_jax.plots.pose import snapshot
from dropper_jax.plots.system import body_motion
from dropper_jax.plots.tension import tension_history
from dropper_jax.plots.water import response, tension_envelope, under_surface

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
