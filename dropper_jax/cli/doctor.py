"""`dropper doctor`: check the installation, and list its versions and devices."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from typing import TYPE_CHECKING

from dropper_jax.base.machine import in_words
from dropper_jax.cli.given import positive_integer
from dropper_jax.cli.options import add_examples, add_json
from dropper_jax.cli.printing import done_object, listing, print_result

if TYPE_CHECKING:
    from dropper_jax.study.doctor import Cache, Installation

help = "versions, devices, cache, and checks against known results"


def add_arguments(parser: ArgumentParser) -> None:
    add_examples(
        parser,
        "doctor --json",
        "doctor --repeats 200000",
    )
    parser.add_argument(
        "--repeats",
        type=positive_integer,
        default=400,
        metavar="N",
        help="calls of one program whose bits are compared (default: 400; 200000 for a full trial)",
    )
    add_json(parser)


def run(args: Namespace) -> int:
    from dropper_jax.study.doctor import examine

    found = examine(args.repeats)
    failed = [check.name for check in found.checks if not check.ok]
    failure = ("unhealthy", f"failed checks: {', '.join(failed)}") if failed else None
    return print_result(args, done_object(**asdict(found)), text(found), failure)


def text(found: Installation) -> str:
    """The report as text."""
    pairs = []
    for extra, packages in found.versions.items():
        named = ", ".join(f"{name} {version or 'is not installed'}" for name, version in packages.items())
        label = "versions" if extra == "needed" else f"extra {extra}"
        pairs.append((label, named))
    system = found.system
    pairs.append(("system", f"{system.platform}, {system.cores} cores, free memory {in_words(system.memory_bytes)}"))
    pairs.append(("devices", ", ".join(found.devices)))
    precision = "float64" if found.float64 else "float32 (JAX_ENABLE_X64 is off)"
    pairs.append(("precision", precision))
    if found.devices[0].startswith("cpu"):
        kernel = "each run is one CPU kernel" if found.one_kernel else "off"
        pairs.append(("one kernel", kernel))
        options = [f"{name} {OPTION_WORDS[known]}" for name, known in found.compiler_options.items()]
        pairs.append(("compiler", ", ".join(options)))
    pairs.append(("cache", _cache_in_words(found.cache)))
    for check in found.checks:
        pairs.append((check.name, f"{CHECK_WORDS[check.ok]}: {check.found}"))
    return listing(pairs)


#: Words for an option that the compiler has or lacks, and for a check that holds or fails.
OPTION_WORDS = {True: "known", False: "UNKNOWN"}
CHECK_WORDS = {True: "ok", False: "WRONG"}


def _cache_in_words(cache: Cache) -> str:
    if not cache.folder:
        return "off"
    return f"{cache.folder}: {cache.programs} programs, {in_words(cache.bytes)}"
