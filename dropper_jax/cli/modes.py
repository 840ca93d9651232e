"""`dropper modes SCENE`: natural periods, damping ratios and shapes about the equilibrium."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.options import (
    add_examples,
    add_scene,
    done_object,
    number,
    positive_integer,
    print_result,
    read_scene,
    table,
)
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.statics.modes import Modes

help = "natural periods, damping ratios and modes about the static equilibrium"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_examples(
        parser,
        "modes dropper-release-a --count 5",
        "modes paper-case-4 --amplitude 0.1 --plot modes.png",
    )
    add_scene(parser)
    parser.add_argument("--count", type=positive_integer, default=10, help="number of modes, the slowest first (10)")
    parser.add_argument(
        "--amplitude",
        type=number,
        metavar="A",
        help="also damping ratios at an amplitude of A metres, with quadratic drag",
    )
    add_plot(parser, "the shapes of the nine slowest modes")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    if args.amplitude is not None and not 0.0 < args.amplitude < np.inf:
        raise SceneError(f"--amplitude: {args.amplitude:g} is out of range; allowed: above 0 m")
    scene = read_scene(args)

    from dropper_jax.run.build import build_model, equilibrium
    from dropper_jax.statics.modes import damping_at, natural_modes

    model = build_model(scene)
    pose = equilibrium(model)
    if pose.status != "ok":
        return print_result(args.json, {"scene": scene.name}, failure=(pose.status, f"{pose.status}: {pose.message}"))
    modes = natural_modes(model, pose.state, args.count)
    if args.plot:
        from dropper_jax.study.pictures import mode_shapes

        mode_shapes(scene, model, pose, modes, picture(args.plot, "modes"))
    found = {"period_s": modes.period, "frequency_hz": 1.0 / modes.period, "shape": modes.shape}
    found |= {"damping_ratio": modes.damping_ratio, "critical_damping_kg_per_s": modes.critical_damping}
    if args.amplitude is not None:
        ratio = damping_at(model, pose.state, modes, args.amplitude)
        found |= {"amplitude_m": args.amplitude, "damping_ratio_at_amplitude": ratio}
    if modes.bodies is not None:
        found["bodies"] = {body.name: modes.bodies[:, i] for i, body in enumerate(scene.bodies)}
    return deliver(args.json, done_object(scene=scene.name, **found), _text(scene, modes, found), args.out)


def _text(scene: Scene, modes: Modes, found: dict[str, Any]) -> str:
    ratios = {"damping ratio": modes.damping_ratio}
    if "amplitude_m" in found:
        ratios[f"at {found['amplitude_m']:g} m"] = found["damping_ratio_at_amplitude"]
    rows = [("mode", "period [s]", "frequency [Hz]", *ratios, "fraction of x, y, z in the motion")]
    for i, (period, shape) in enumerate(zip(modes.period, modes.shape, strict=True)):
        share = np.sum(shape**2, axis=0) / np.sum(shape**2)
        damping = (f"{ratio[i]:.3g}" for ratio in ratios.values())
        rows.append((str(i + 1), f"{period:.5g}", f"{1 / period:.5g}", *damping, "  ".join(f"{x:.2f}" for x in share)))
    return table(rows) if modes.bodies is None else f"{table(rows)}\n{_bodies(scene, modes.bodies)}"


def _bodies(scene: Scene, moved: np.ndarray) -> str:
    """Motion of the bodies in each mode: displacement of the reference point, rotation about the scene's axes."""
    heads = ("mode", "body", "surge [m]", "sway [m]", "heave [m]", "roll [rad]", "pitch [rad]", "yaw [rad]")
    rows = (
        (str(i), body.name, *(f"{x:.3f}" for x in own))
        for i, mode in enumerate(moved, 1)
        for body, own in zip(scene.bodies, mode, strict=True)
    )
    return table([heads, *rows])
