"""`dropper optimise SITE.toml`: the design that meets a site's limits at minimum cost, by derivatives of its storms."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from dropper_jax.base.markdown import text_row
from dropper_jax.cli.given import output_file
from dropper_jax.cli.options import add_effects, add_examples, add_json, add_quiet, register_effects
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import FAILED, done_object, print_line, print_result, print_warnings, progress, table

if TYPE_CHECKING:
    from fitting.farm.optimise.optimum import Optimum

help = "design a farm: minimum material, load or motion within a site's limits"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_examples(
        parser,
        "optimise small-longline --check",
        "optimise site.toml --state search.json --plot design",
    )
    parser.add_argument("site", metavar="SITE.toml", help="the site, with [[variable]] and [objective]")
    parser.add_argument("--state", metavar="FILE.json", help="save the search here; resumes an existing one")
    add_plot(parser, "layout and utilisation, before and after,")
    add_out(parser)
    parser.add_argument("--check", action="store_true", help="only check the site and the derivatives")
    add_effects(parser)
    add_json(parser)
    add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    state = output_file(args.state, "--state", (".json",))

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
        return print_result(args, result, f"{along_text(along)}: {along.status}")
    found = optimise(site, state, say)
    status = "ok"
    outcome = "ok"
    if not found.feasible:
        status = "not_converged"
        outcome = "no design met all constraints"
    say(1.0, outcome)
    print_warnings(found.warnings)
    if args.plot:
        from fitting.farm.optimise.picture import design_picture

        design_picture(site, found, picture(args.plot, "design"))
    plain = {"schema": 1, "status": status, "site": site.name, **found.to_json()}
    code = deliver(args, plain, text(found))
    if found.feasible:
        return code
    print_line("error: none of the designs found meets all constraints on whole runs")
    return FAILED


def text(found: Optimum) -> str:
    """The design as text: before, after, active constraints, sensitivity to assumptions."""
    from fitting.farm.optimise.along_gradient import along_text
    from fitting.farm.optimise.optimum import ACTIVE_FROM, MIN_BALANCED

    rows = [("", "before", "after", "bounds")]
    for variable, before, after in zip(found.variables, found.before, found.after, strict=True):
        rows.append(text_row("{0.name}|{1:.4g}|{2:.4g}|{0.low:g} to {0.high:g}", variable, before, after))
    rows.append(text_row("objective ({0.of})|{0.objective[0]:.5g}|{0.objective[1]:.5g}|{1:+.1%}", found, -found.gain))
    known = found.held >= MIN_BALANCED
    limits = [("constraint, limit 1", "before", "after", "effect of 1 % more of it")]
    for label, (before, after) in found.constraints.items():
        price = "active" if after >= ACTIVE_FROM else ""
        if known and label in found.prices:
            price = f"{found.prices[label]:+.3g}"
        limits.append((label, f"{before:.3f}", f"{after:.3f}", price))
    assumed = [("1 % more of", "objective")]
    for name, change in found.assumptions.items():
        effect = "unknown: no optimum"
        if known:
            effect = f"{change:+.3g}"
        assumed.append((name, effect))
    apart = "windows and whole runs were not compared, because the start is the best design"
    if not math.isnan(found.residual):
        apart = f"windows and whole runs differed by up to {found.residual:.1%} of a limit before the last update"
    end = (
        f"constraints of whole runs, {found.characteristic}; "
        f"{along_text(found.along)}; {apart}; "
        f"constraints and bounds balance {max(found.held, 0.0):.0%} of the objective's slope; {found.rounds} rounds, "
        f"{found.runs} evaluations"
    )
    tables = [rows, limits, assumed]
    if found.dominated:
        cells = "{0[constraint]}|{0[variable]}|{0[mean]:+.3g}|{0[median]:+.3g}|{0[seed]}"
        head = ("derivative of", "by", "mean of seeds", "median", "dominated by seed")
        tables.append([head, *(text_row(cells, one) for one in found.dominated)])
    return "\n\n".join([*map(table, tables), end])
