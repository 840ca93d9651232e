"""`dropper optimise SITE.toml`: the design that meets a site's limits at minimum cost, by derivatives of its storms."""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from dropper_jax.base.markdown import Rows, text_row
from dropper_jax.cli.options import add_effects, add_examples, add_flag, add_json, add_quiet, register_effects
from dropper_jax.cli.outputs import add_file, add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import Failure, done_object, print_warnings, progress, table

if TYPE_CHECKING:
    from fitting.farm.optimise.optimum import Optimum

help = "design a farm: minimum material, load or motion within a site's limits"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "optimise small-longline --check",
        "optimise site.toml --state search.json --plot design",
    )
    parser.add_argument("site", metavar="SITE.toml", help="the site, with [[variable]] and [objective]")
    add_file(parser, "--state", (".json",), "save the search here; resumes an existing one", "FILE.json")
    add_plot(parser, "layout and utilisation, before and after,")
    add_out(parser)
    add_flag(parser, "--check", "only check the site and the derivatives")
    add_effects(parser)
    add_json(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    from fitting.farm.optimise.along_gradient import along_error, along_text, check_along
    from fitting.farm.optimise.run import optimise, read_problem
    from fitting.farm.site import read_site

    register_effects(args)
    site = read_site(args.site)
    say = progress(args.quiet)
    if args.check:
        problem = read_problem(site)
        along = check_along(problem, say)
        say(1.0, "ok")
        result = done_object(check=along_error(along), along=along._asdict())
        return deliver(args, result, f"{along_text(along)}: {along.status}")
    found = optimise(site, args.state, say)
    failure: Failure | None = None
    if not found.feasible:
        failure = ("not_converged", "none of the designs found meets all constraints on whole runs")
    say(1.0, "ok" if found.feasible else "no design met all constraints")
    print_warnings(found.warnings)
    if args.plot:
        from fitting.farm.optimise.picture import draw_design

        draw_design(site, found, picture(args.plot, "design"))
    return deliver(args, done_object(site=site.name, **found.to_json()), text(found), failure)


def text(found: Optimum) -> str:
    """The design as text: before, after, active constraints, sensitivity to assumptions."""
    tables = [_value_rows(found), _constraint_rows(found), _assumption_rows(found)]
    if found.dominated:
        cells = "{0[constraint]}|{0[variable]}|{0[mean]:+.3g}|{0[median]:+.3g}|{0[seed]}"
        head = ("derivative of", "by", "mean of seeds", "median", "dominated by seed")
        tables.append([head, *(text_row(cells, one) for one in found.dominated)])
    return "\n\n".join([*map(table, tables), _remarks(found)])


def _value_rows(found: Optimum) -> Rows:
    """The variables and the objective, before and after."""
    rows = [("", "before", "after", "bounds")]
    for variable, before, after in zip(found.variables, found.before, found.after, strict=True):
        rows.append(text_row("{0.name}|{1:.4g}|{2:.4g}|{0.low:g} to {0.high:g}", variable, before, after))
    rows.append(text_row("objective ({0.of})|{0.objective[0]:.5g}|{0.objective[1]:.5g}|{1:+.1%}", found, -found.gain))
    return rows


def _constraint_rows(found: Optimum) -> Rows:
    """The constraints, before and after, and what 1 % more of the limit of an active one changes."""
    from fitting.farm.optimise.optimum import ACTIVE_FROM

    rows = [("constraint, limit 1", "before", "after", "effect of 1 % more of it")]
    for label, (before, after) in found.constraints.items():
        effect = "active" if after >= ACTIVE_FROM else ""
        if _is_optimum(found) and label in found.prices:
            effect = f"{found.prices[label]:+.3g}"
        rows.append((label, f"{before:.3f}", f"{after:.3f}", effect))
    return rows


def _assumption_rows(found: Optimum) -> Rows:
    """What 1 % more of an assumption changes, if that is known."""
    rows = [("1 % more of", "objective")]
    for name, change in found.assumptions.items():
        effect = f"{change:+.3g}" if _is_optimum(found) else "unknown: no optimum"
        rows.append((name, effect))
    return rows


def _is_optimum(found: Optimum) -> bool:
    """Whether constraints and bounds balance the slope of the objective: only then do their effects follow from it."""
    from fitting.farm.optimise.optimum import MIN_BALANCED

    return found.held >= MIN_BALANCED


def _remarks(found: Optimum) -> str:
    """How the design was found and checked, in words."""
    from fitting.farm.optimise.along_gradient import along_text

    apart = "windows and whole runs were not compared, because the start is the best design"
    if not math.isnan(found.residual):
        apart = f"windows and whole runs differed by up to {found.residual:.1%} of a limit before the last update"
    text = (
        "constraints of whole runs, {0.characteristic}; {1}; {2}; constraints and bounds balance {3:.0%} of the "
        "objective's slope; {0.rounds} rounds, {0.runs} evaluations"
    )
    return text.format(found, along_text(found.along), apart, max(found.held, 0.0))
