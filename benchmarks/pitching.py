"""The paper's spar, cases 1 to 3, upright against free to pitch, and its centre of gravity swept.

    python benchmarks/pitching.py

Writes `results/pitching.json`. Runs are 200 s long and are looked at from 60 s on. Both forms have the chain at the
middle of the base, whose motion is that of the point `buoy`. The centre of gravity is swept in case 1, with the natural
periods of pitch; a homogeneous spar starts upright, where it is not stable. Case 1 is run again without drag across the
spar, which tells how much of the difference is drag.
"""

from collections.abc import Callable

import numpy as np
from study import Found, collect, command, spread

import dropper_jax as dj
from dropper_jax.load.packaged import packaged_scene, pitching

CASES = ("paper-case-1", "paper-case-2", "paper-case-3")
#: Heights of the centre of gravity above the base [m]; the last one is that of a homogeneous spar.
CENTRES = (0.5, 0.75, 1.0, 1.25, 1.5, 8.865 / 2)
SKIP = 60.0


def measured(scene: dj.Scene) -> Found:
    """Tensions at both ends of the chain [N], motion of the base [m] and tilt [deg] after the transient.

    The tilt is the angle between the spar's axis and the vertical.
    """
    run = dj.simulate(scene)
    late, tension = run.t >= SKIP, run.tension[run.t_tension >= SKIP]
    base = run.point_path("buoy")[late]
    found = {
        "status": run.status,
        "retried": int(run.retried_steps),
        "anchor_n": spread(tension[:, 0]),
        "buoy_n": spread(tension[:, -1]),
        "anchor_99_n": float(np.percentile(tension[:, 0], 99)),
        "buoy_99_n": float(np.percentile(tension[:, -1], 99)),
        "heave_m": spread(base[:, 2]),
        "away_m": spread(np.hypot(base[:, 0], base[:, 1])),
    }
    if run.body_attitude is not None:
        roll, pitch = run.body_attitude[late, 0, 0], run.body_attitude[late, 0, 1]
        tilt = np.degrees(np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0)))
        found["tilt_deg"] = spread(tilt)
        found["capsized_share"] = float(np.mean(tilt > 60.0))
    return found


def pitch_period(scene: dj.Scene) -> float | None:
    """Natural period [s] of the mode about the pose in calm water in which the spar pitches most; None if it lies."""
    calm = scene.to_dict()
    calm["sea"] = {"depth": scene.sea.depth, "density": scene.sea.density, "gravity": scene.sea.gravity}
    still = dj.load_scene(calm)
    pose = dj.equilibrium(still)
    model = dj.build_model(still)
    axes = model.constraints[0].pose(model, pose.state.r)[1]
    if axes[0, 2, 2] < np.cos(0.5):
        return None  # it rests on its side
    modes = dj.natural_modes(model, pose.state, 12)
    pitch = np.abs(modes.bodies[:, 0, 4])
    size = np.linalg.norm(modes.bodies[:, 0, :3], axis=1) / scene.bodies[0].extent + pitch
    share = np.where(pitch < 0.2 * np.max(pitch), 0.0, pitch / np.maximum(size, 1e-12))
    return float(modes.period[int(np.argmax(share))])


def without_drag(scene: dj.Scene) -> dj.Scene:
    """The scene without drag across its spar."""
    path = "body.spar.cylinders.0.cdn" if scene.bodies else "buoy.spar.cdn"
    return scene.with_values({path: 0.0})


@command()
def main() -> None:
    def row(case: str, form: str, change: Callable[[dj.Scene], dj.Scene]) -> Found:
        scene = dj.load_scene(case if form == "upright" else f"{case}-{form}")
        return {"case": case, "form": form, **measured(change(scene))}

    def moved(centre: float) -> Found:
        scene = dj.load_scene(pitching(packaged_scene(CASES[0]), centre))
        return {"centre_m": centre, "pitch_period_s": pitch_period(scene), **measured(scene)}

    forms = ("upright", "pitching")
    parts = {
        "cases": (row(case, form, lambda scene: scene) for case in CASES for form in forms),
        "centres": map(moved, CENTRES),
        "without_drag": (row(CASES[0], form, without_drag) for form in forms),
    }
    collect("pitching", parts, from_s=SKIP, to_s=200.0)
