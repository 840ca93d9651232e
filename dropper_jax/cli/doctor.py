"""`dropper doctor`: check the installation, and list its versions and devices."""

from __future__ import annotations

import argparse

from dropper_jax.base.memory import in_words
from dropper_jax.base.read import Table
from dropper_jax.cli.given import positive_integer
from dropper_jax.cli.options import add_examples, add_json
from dropper_jax.cli.printing import done_object, listing, print_result

help = "versions, devices, cache, and checks against known results"


def add_arguments(parser: argparse.ArgumentParser) -> None:
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


def run(args: argparse.Namespace) -> int:
    from dropper_jax.study.doctor import examine

    found = examine(args.repeats)
    failed = [check["name"] for check in found["checks"] if not check["ok"]]
    failure = None
    if failed:
        failure = ("unhealthy", f"failed checks: {', '.join(failed)}")
    return print_result(args, done_object(**found), text(found), failure)


def text(found: Table) -> str:
    """The report as text."""
    pairs = []
    for extra, packages in found["versions"].items():
        named = ", ".join(f"{name} {version or 'is not installed'}" for name, version in packages.items())
        pairs.append(("versions" if extra == "needed" else f"extra {extra}", named))
    system = found["system"]
    cache = found["cache"]
    kept = f"{cache['folder']}: {cache['programs']} programs, {in_words(cache['bytes'])}"
    pairs += [
        ("system", f"{system['platform']}, {system['cores']} cores, free memory {in_words(system['memory_bytes'])}"),
        ("devices", ", ".join(found["devices"])),
        ("precision", "float64" if found["float64"] else "float32 (JAX_ENABLE_X64 is off)"),
        *(_on_processor(found) if found["devices"][0].startswith("cpu") else ()),
        ("cache", kept if cache["folder"] else "off"),
        *((check["name"], f"{'ok' if check['ok'] else 'WRONG'}: {check['found']}") for check in found["checks"]),
    ]
    return listing(pairs)


def _on_processor(found: Table) -> tuple[tuple[str, str], ...]:
    options = found["compiler_options"]
    return (
        ("one kernel", "each run is one CPU kernel" if found["one_kernel"] else "off"),
        ("compiler", ", ".join(f"{name} {'known' if known else 'UNKNOWN'}" for name, known in options.items())),
    )
