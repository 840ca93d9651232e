"""`dropper modes SCENE`: natural periods about the static pose."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.cli.codes import FAILED, OK
from dropper_jax.cli.options import add_scene, read_scene, whole_number
from dropper_jax.cli.output import done_object, failure_object, print_json, print_line, table

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene

help = "natural periods and modes about the static pose of an elastic scene"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument("--count", type=whole_number, default=10, help="how many, the slowest first (10)")


def run(args: argparse.Namespace) -> int:
    scene = read_scene(args)

    from dropper_jax.run.build import build_model, equilibrium
    from dropper_jax.statics.modes import natural_modes

    pose = equilibrium(scene)
    if pose.status != "ok":
        message = f"{pose.status}: {pose.message}"
        print_line(f"error: {message}")
        if args.json:
            print_json({**failure_object(pose.status, message), "scene": scene.name})
        return FAILED
    modes = natural_modes(build_model(scene), pose.state, args.count)
    if args.json:
        found = {"period_s": modes.period, "frequency_hz": 1.0 / modes.period, "shape": modes.shape}
        if modes.bodies is not None:
            found["bodies"] = {body.name: modes.bodies[:, i] for i, body in enumerate(scene.bodies)}
        print_json(done_object(scene=scene.name, **found))
        return OK
    rows = [("mode", "period [s]", "frequency [Hz]", "share of x, y, z in the motion")]
    for i, (period, shape) in enumerate(zip(modes.period, modes.shape, strict=True), 1):
        share = np.sum(shape**2, axis=0) / np.sum(shape**2)
        rows.append((str(i), f"{period:.5g}", f"{1 / period:.5g}", "  ".join(f"{x:.2f}" for x in share)))
    print(table(rows))
    if modes.bodies is not None:
        print(_bodies(scene, modes.bodies))
    return OK


def _bodies(scene: Scene, moved: np.ndarray) -> str:
    """Motion of the bodies in each mode: moves of the reference point, and turns about the scene's axes."""
    rows = [("mode", "body", "surge [m]", "sway [m]", "heave [m]", "roll [rad]", "pitch [rad]", "yaw [rad]")]
    for i, mode in enumerate(moved, 1):
        rows += [(str(i), body.name, *(f"{x:.3f}" for x in own)) for body, own in zip(scene.bodies, mode, strict=True)]
    return table(rows)
