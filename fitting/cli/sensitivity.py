"""`dropper sensitivity SCENE --of QUANTITY --to NAMES`: what a quantity depends on, locally and over ranges."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.codes import FAILED, OK
from dropper_jax.cli.options import add_scene, number, output_file, read_scene
from dropper_jax.cli.output import listing, print_json, print_line, progress, table
from dropper_jax.run.solution import jsonable

if TYPE_CHECKING:
    from fitting.sensitivity.derivatives import Local
    from fitting.sensitivity.screening import Global

name = "sensitivity"
help = "how much a quantity depends on parameters: exact derivatives, Sobol indices, Morris screening"

#: Options that stand for a value of the scene.
OVERRIDES = ("integrator", "dt", "duration")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--of", required=True, metavar="QUANTITY", help="such as tension.3.max, angle.1.std, excursion.max"
    )
    parser.add_argument("--to", required=True, metavar="NAMES", help="parameters, such as b_l,b_q,line.0.mass")
    parser.add_argument("--global", dest="method", choices=("sobol", "morris"), help="indices over ranges instead")
    parser.add_argument(
        "--range",
        action="append",
        default=[],
        metavar="NAME=LO:HI",
        help="range of a parameter (default: 20 %% each way)",
    )
    parser.add_argument("--samples", type=int, default=64, help="size of a global study (default: 64)")
    parser.add_argument("--seed", type=int, default=0, help="of a global study")
    parser.add_argument("--picture", metavar="FILE.png", help="tornado picture")
    parser.add_argument("--integrator", help="time integration scheme")
    parser.add_argument("--dt", type=number, help="time step [s]")
    parser.add_argument("--duration", type=number, help="simulated time [s]")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    scene = read_scene(args, {f"run.{key}": getattr(args, key) for key in OVERRIDES})
    picture = output_file(args.picture, "--picture", (".png",))
    if args.samples < 2:
        raise SceneError(f"--samples: {args.samples}; allowed: a whole number >= 2")

    from fitting import sensitivity
    from fitting.sensitivity import screening

    problem = sensitivity.study(scene, args.of, args.to.split(","))
    if args.method:
        box = sensitivity.ranges(problem, dict(_range(text) for text in args.range))
        found: Any = screening.global_indices(problem.batch, problem.names, box, args.method, args.samples, args.seed)
        ok = True
    else:
        found = sensitivity.local(problem, progress(args.quiet) or (lambda fraction, text: None))
        ok = bool(np.isfinite(found.value) and np.isfinite(found.forward).all())
    if picture and ok:
        from fitting.sensitivity import tornado

        if args.method:
            tornado.global_picture(found, args.of, picture)
        else:
            tornado.local_picture(found, picture)
    return _report(found, args, ok)


def _report(found: Any, args: argparse.Namespace, ok: bool) -> int:
    status = "ok" if ok else "not_converged"
    message = "" if ok else f"{args.of}: a step of the run failed; see `dropper run`"
    if args.json:
        import dataclasses

        values = {"schema": 1, "status": status, "of": args.of, **dataclasses.asdict(found)}
        if not args.method:
            values |= {"scaled": found.scaled, "trusted": found.trusted}
        print_json(jsonable(values | ({"error": message} if message else {})))
    else:
        print(global_text(found, args.of) if args.method else local_text(found))
    if message:
        print_line(f"error: {message}")
    return OK if ok else FAILED


def _range(text: str) -> tuple[str, tuple[float, float]]:
    try:
        name, values = text.split("=")
        low, high = (float(x) for x in values.split(":"))
    except ValueError:
        raise SceneError(f"--range: {text!r} is not NAME=LO:HI; allowed: such as b_l=0.001:0.004") from None
    return name.strip(), (low, high)


def local_text(found: Local) -> str:
    """Derivatives for people, the largest first, and how far to trust them."""
    order = np.argsort(-np.abs(found.scaled if np.isfinite(found.scaled).all() else found.forward))
    head = ["parameter", "value", "dQ/dp", "p/Q dQ/dp"]
    windowed = not found.trusted
    rows = [head + (["window mean", "std error"] if windowed else [])]
    for i in order:
        row = [
            found.names[i],
            f"{found.values[i]:.5g} {found.units[i]}",
            f"{found.forward[i]:.6g}",
            f"{found.scaled[i]:.4g}",
        ]
        rows.append(row + ([f"{found.window_mean[i]:.5g}", f"{found.window_error[i]:.2g}"] if windowed else []))
    trust = (
        "the whole run"
        if found.trusted
        else f"up to {found.horizon:.3g} s only: beyond, small changes grow more than 100 times"
    )
    pairs = [
        ("quantity", f"{found.of} = {found.value:.6g} {found.unit} over {found.duration:g} s"),
        ("modes", f"forward and reverse differ by {found.mismatch:.1e}"),
        ("trust", f"{trust} (growth rate {found.exponent:.2g} per s)"),
    ]
    if windowed:
        pairs.append(("windows", f"of {found.window:.3g} s: the quantity of each, averaged over the motion"))
    return f"{listing(pairs)}\n\n{table(rows)}"


def global_text(found: Global, of: str) -> str:
    """Indices for people, the largest first."""
    sobol = found.method == "sobol"
    rows = [
        [
            "parameter",
            "from",
            "to",
            *(("first", "+-", "total", "+-") if sobol else ("mean |effect|", "+-", "spread", "")),
        ]
    ]
    for i in np.argsort(-found.total if sobol else -found.first):
        numbers = (found.first[i], found.first_error[i], found.total[i], found.total_error[i])
        cells = ["" if np.isnan(x) else f"{x:.3g}" for x in numbers]
        rows.append([found.names[i], *(f"{x:.4g}" for x in found.ranges[i]), *cells])
    return f"{of}: {found.runs} runs, mean {found.mean:.5g}, standard deviation {found.std:.3g}\n\n{table(rows)}"
