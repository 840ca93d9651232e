"""`dropper modes SCENE`: natural periods, damping ratios and shapes about the equilibrium."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.markdown import cells
from dropper_jax.base.read import Table
from dropper_jax.base.records import names_of
from dropper_jax.cli.given import positive, positive_integer
from dropper_jax.cli.options import add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import done_object, failure_of, table

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.statics.modes import Modes

help = "natural periods, damping ratios and modes about the static equilibrium"

#: Digits of a damping ratio: those beyond are rounding of the mode shapes.
RATIO_DIGITS = 6


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, "modes dropper-release-a --count 5", "modes paper-case-4 --amplitude 0.1 --plot modes.png")
    parser.add_argument("--count", type=positive_integer, default=10, help="number of modes, the slowest first (10)")
    parser.add_argument(
        "--amplitude",
        type=positive("m"),
        metavar="A",
        help="also damping ratios at an amplitude of A metres, with quadratic drag",
    )
    parser.add_argument(
        "--of",
        metavar="BODY",
        help="the modes with the largest share of their kinetic energy in this body, the slowest first",
    )
    add_plot(parser, "the shapes of the first nine of these modes")
    add_out(parser)


def run(args: Namespace) -> int:
    scene = read_scene(args)
    body = None if args.of is None else _number_of(args.of, scene)

    from dropper_jax.modelling.build import build_model, equilibrium
    from dropper_jax.statics.modes import damping_at, natural_modes

    model = build_model(scene)
    pose = equilibrium(model)
    if pose.status != "ok":
        return deliver(args, {"scene": scene.name}, "", failure_of(pose))
    if body is None:
        modes = natural_modes(model, pose.state, args.count)
        numbers = np.arange(len(modes.period))
    else:
        every = natural_modes(model, pose.state)
        numbers = np.sort(np.argsort(-every.body_share[:, body])[: args.count])
        modes = every.pick(numbers)
    if args.plot:
        from dropper_jax.study.rest_pictures import mode_shapes

        mode_shapes(scene, model, pose, modes, numbers + 1, picture(args.plot, "modes"))
    found = {"number": numbers + 1, "period_s": modes.period, "frequency_hz": 1.0 / modes.period, "shape": modes.shape}
    found |= {"damping_ratio": modes.damping_ratio, "critical_damping_kg_per_s": modes.critical_damping}
    if args.amplitude is not None:
        ratio = damping_at(model, pose.state, modes, args.amplitude)
        found |= {"amplitude_m": args.amplitude, "damping_ratio_at_amplitude": ratio}
    if scene.bodies:
        names = names_of(scene.bodies)
        found["bodies"] = dict(zip(names, np.moveaxis(modes.bodies, 1, 0), strict=True))
        found["body_share"] = dict(zip(names, modes.body_share.T, strict=True))
    return deliver(args, done_object(scene=scene.name, **found), _text(scene, modes, found))


def _number_of(name: str, scene: Scene) -> int:
    """Index of a body of the scene."""
    names = names_of(scene.bodies)
    if name not in names:
        allowed = nearest(name, names) if names else "the scene has no [[body]]; leave --of out"
        raise SceneError(f"--of: {name!r} is not a body; {allowed}")
    return names.index(name)


def _text(scene: Scene, modes: Modes, found: Table) -> str:
    """A row per mode; with bodies also their motions."""
    ratios = {"damping ratio": modes.damping_ratio}
    if "amplitude_m" in found:
        ratios[f"at {found['amplitude_m']:g} m"] = found["damping_ratio_at_amplitude"]
    rows = [("mode", "period [s]", "frequency [Hz]", *ratios, "fraction of x, y, z in the motion")]
    damping = np.round(np.transpose(list(ratios.values())), RATIO_DIGITS) + 0.0  # -0 becomes 0
    square = np.sum(modes.shape**2, axis=1)
    share = square / np.sum(square, axis=1, keepdims=True)
    for mode, period, own, part in zip(found["number"], modes.period, damping, share, strict=True):
        numbers = [*cells((period, 1 / period), ".5g"), *cells(own, ".3g")]
        rows.append((str(mode), *numbers, "  ".join(cells(part, ".2f"))))
    if scene.bodies:
        return f"{table(rows)}\n{_bodies(scene, modes, found['number'])}"
    return table(rows)


def _bodies(scene: Scene, modes: Modes, numbers: np.ndarray) -> str:
    """Motion of the bodies in each mode: share of the kinetic energy, displacement of the reference point, rotation
    about the scene's axes."""
    heads = ("mode", "body", "share", "surge [m]", "sway [m]", "heave [m]", "roll [rad]", "pitch [rad]", "yaw [rad]")
    rows: list[tuple[str, ...]] = [heads]
    for i, mode, shares in zip(numbers, modes.bodies, modes.body_share, strict=True):
        for body, own, share in zip(scene.bodies, mode, shares, strict=True):
            rows.append((str(i), body.name, f"{share:.2f}", *cells(np.round(own, 3) + 0.0, ".3f")))
    return table(rows)
