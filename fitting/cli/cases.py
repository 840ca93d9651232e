"""`dropper cases SITE.toml --out FOLDER`: all load cases of a site, utilisation of its parts, a one-page report."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError
from dropper_jax.base.machine import available_cores
from dropper_jax.base.markdown import bullets
from dropper_jax.base.read import Table
from dropper_jax.cli.given import positive_integer
from dropper_jax.cli.options import add_effects, add_examples, add_flag, add_json, add_quiet, register_effects
from dropper_jax.cli.outputs import add_folder
from dropper_jax.cli.printing import Failure, done_object, listing, print_result, progress

if TYPE_CHECKING:
    from fitting.farm.site import Site

help = "run the load cases of a site and report the utilisation of each part"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "cases small-longline --list",
        "cases site.toml --out results --workers 2",
    )
    parser.add_argument("site", metavar="SITE.toml", help="the site: scene, sea states, parts; or a packaged one")
    add_folder(parser, "--out", "runs, and cases.md, cases.csv, cases.json")
    add_flag(parser, "--resume", "resume the runs in the folder")
    add_flag(parser, "--list", "only list the cases")
    add_flag(parser, "--print", "only print the site's file, to save and edit")
    parser.add_argument("--workers", type=positive_integer, metavar="N", help="processes (default: one per core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers run the cases")
    add_effects(parser)
    add_json(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    out: Path | None = args.out
    if not (args.print or args.list):
        if out is None:
            raise SceneError("--out: missing; needed: a folder for the runs and the report, or --list")
        if any(out.glob("runs/*.npz")) and not args.resume:
            raise SceneError(f"--out: {str(out)!r} already contains runs. Use --resume, or another folder")

    from fitting.farm.site import read_site, site_text

    if args.print:
        toml = site_text(args.site).decode().rstrip()
        return print_result(args, done_object(toml=toml), toml)
    register_effects(args)
    site = read_site(args.site)
    if out is None or args.list:
        return _print_cases(site, args)
    return _run_and_assess(site, out, args)


def _run_and_assess(site: Site, out: Path, args: Namespace) -> int:
    """Run the cases of a site, and report the utilisation of its parts."""
    from fitting.farm.cases.assess import assess
    from fitting.farm.cases.case_store import CasesStopped
    from fitting.farm.cases.page import write_page
    from fitting.farm.cases.run import run_cases
    from fitting.farm.cases.step_errors import step_errors

    how: Table = {
        "workers": args.workers or available_cores(),
        "scheduler": args.scheduler,
        "progress": progress(args.quiet),
    }
    try:
        done = run_cases(site, out, **how)
        steps = step_errors(site, out, assess(site, out), **how)
    except CasesStopped as error:
        return print_result(args, {}, failure=("interrupted", str(error)))
    found = assess(site, out, steps)
    files = write_page(found, out)
    found |= {"out": str(out), "runs": done.runs, "resumed": done.resumed, "run_s": done.run_s}
    failure: Failure | None = None
    if found["failed"]:
        failure = (found["status"], f"{len(found['failed'])} of {len(site.cases)} runs are missing or failed")
    return print_result(args, found, text(found, files), failure)


def _print_cases(site: Site, args: Namespace) -> int:
    """Print the cases of a site."""
    names = [storm.name for storm in site.storms]
    found = done_object(site=site.name, cases=names, runs=len(site.cases))
    lines = [f"{i}  {name}" for i, name in enumerate(names)]
    lines.append(f"\ncases: {len(names)}, runs: {len(site.cases)}")
    return print_result(args, found, "\n".join(lines))


def text(found: Table, files: dict[str, Path]) -> str:
    """The result as text."""
    storms = {case["case"]: case["name"] for case in found["cases"]}
    pairs = [("cases", f"{len(found['cases'])}, {found['runs']} runs, {found['resumed']} of them resumed")]
    for part in found["parts"]:
        row = part["worst"]
        worst = "no run"
        if row is not None:
            worst = f"utilisation {row['utilisation']:.2f} in {storms[row['case']]}"
        pairs.append((part["part"], worst))
    flags = bullets(found["flags"])
    verdict = "all limits hold" if found["passes"] else "not all limits hold"
    return "\n\n".join(filter(None, (listing(pairs), flags, f"{verdict}: {files['page']}")))
