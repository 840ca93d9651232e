"""`dropper cost SCENE`: cost of each effect of a scene per step."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from dropper_jax.base.read import Table
from dropper_jax.base.table_cells import record_cells, yes_no
from dropper_jax.cli.options import add_quiet, add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import STOPPED, done_object, record_table, row_printer

help = "operations, bytes and microseconds per step, with and without each effect"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, "cost dropper-release-a", "cost paper-case-1 --plot cost.png")
    add_plot(parser, "a bar chart")
    add_out(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    scene = read_scene(args)

    from dropper_jax.study.cost import cost
    from dropper_jax.study.cost_picture import draw_costs

    show = row_printer(list(COLUMNS), args.quiet)
    found = cost(scene, each=lambda row: show(record_cells(row, COLUMNS)))
    proof = found["proof"]
    failure = None
    if proof is None:
        failure = STOPPED
    elif not (proof["removed_is_never_had"] and proof["new_effect_changes_nothing"]):
        failure = ("not_converged", "absent effects change the program")
    if args.plot and found["rows"]:
        draw_costs(found, picture(args.plot, "cost"))
    return deliver(args, done_object(**found), text(found), failure)


#: Columns of the table: formats of the values by heading.
COLUMNS = {
    "": "{name}",
    "us/step": "{us_per_step:.2f}",
    "ratio": "{ratio:.2f}",
    "corrections/step": "{corrections_per_step:.2f}",
    "us/correction": "{us_per_correction:.2f}",
    "correction ratio": "{correction_ratio:.2f}",
    "flops": "{flops:.0f}",
    "bytes": "{bytes:.0f}",
    "operations": "{operations:d}",
}


def text(found: Table) -> str:
    """The report as text."""
    parts = [
        "{scene}: scheme {integrator}, solver {solver}".format(**found),
        "us: microseconds; corrections: Newton iterations per step; ratios: to the whole scene",
        "flops, bytes, operations: of the compiled step, which counts a loop once; compare rows only",
        "",
        record_table(found["rows"], COLUMNS),
    ]
    proof = found["proof"]
    if proof is None:  # interrupted
        return "\n".join(parts)
    parts += [
        "",
        "absent effects cost nothing:",
        "  a scene whose effects are removed compiles to the same program as one that never had them: "
        f"{yes_no(proof['removed_is_never_had'])}",
        f"  a new effect in the package leaves the program unchanged: {yes_no(proof['new_effect_changes_nothing'])}",
    ]
    return "\n".join(parts)
