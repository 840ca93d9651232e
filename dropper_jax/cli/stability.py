"""`dropper stability`: a catalogue of hard cases, measured."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Table
from dropper_jax.base.records import by_name
from dropper_jax.cli.options import add_examples, add_flag, add_json, add_quiet
from dropper_jax.cli.outputs import add_out, deliver
from dropper_jax.cli.printing import done_object, progress, record_table

if TYPE_CHECKING:
    from dropper_jax.stability import CaseResult

help = "run a catalogue of hard cases, each against its limit, with the thesis' schemes for comparison"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "stability --short",
        "stability --cases snap-peak --out stability.json",
    )
    add_json(parser)
    parser.add_argument("--cases", nargs="+", metavar="NAME", help="only these (default: all)")
    add_flag(parser, "--short", "shortened runs, without the schemes to compare")
    add_out(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    from dropper_jax.stability import all_cases, evaluate

    known = by_name(all_cases())
    for wanted in args.cases or ():
        if wanted not in known:
            raise SceneError(f"--cases: {wanted!r} is unknown; {nearest(wanted, known)}")
    cases = [case for name, case in known.items() if not args.cases or name in args.cases]
    say = progress(args.quiet)
    rows = []
    for i, case in enumerate(cases):
        say(i / len(cases), case.name)
        rows.append(evaluate(case, args.short, not args.short))
    say(1.0, "done")
    missed = [row.name for row in rows if not row.ok]
    failure = ("not_converged", f"limits exceeded: {', '.join(missed)}") if missed else None
    return deliver(args, done_object(cases=list(map(asdict, rows))), text(rows), failure)


COLUMNS = {
    "case": "{name}",
    "measured": "{measured:.1e}",
    "limit": "{limit:.0e}",
    "unit": "{unit}",
    "holds": "{ok:yes_no}",
    "status": "{status}",
    "thesis_angles 0.51": "{thesis[0]}",
    "thesis_angles 0.5": "{thesis[1]}",
    "theta 0.51": "{thesis[2]}",
    "theta 0.5": "{thesis[3]}",
}


def text(rows: Sequence[CaseResult]) -> str:
    """The result as a table."""
    cells = []
    for row in rows:
        thesis = None
        if row.baseline_thesis is not None:
            thesis = list(map(_short, row.baseline_thesis.values()))
        cells.append({**vars(row), "thesis": thesis})
    claims = [f"{row.name}: {row.claim}" for row in rows]
    return "\n".join([record_table(cells, COLUMNS), "", *claims])


def _short(found: Table) -> str:
    """A baseline in a cell: the time of its failure, or its energy error."""
    if found["status"] == "ok":
        outcome = "WRONG" if found["wrong_energy"] else "ok"
        return f"{outcome}, energy {found['energy_drift_share']:.0e}"
    if "failed_at_s" in found:
        return "{status} at {failed_at_s:.3g} s".format(**found)
    return found["status"]
