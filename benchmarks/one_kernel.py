"""What runs gain by being one kernel: each case with the tag and without it, alternately, one thread.

python benchmarks/one_kernel.py [--pairs 5] [--cases NAME ...] [--out benchmarks/results/one_kernel.json]
"""

import jax
from same_speed import CASES, HERE, Side, measure_both
from study import RESULTS, collect, command, describe


def row(name: str, count: int) -> dict[str, object]:
    """Microseconds per step and seconds of compilation, without and with the tag."""
    compiled, ran = measure_both(Side(HERE, name, True), Side(HERE, name, False), 1, count)
    scale = 1e6 / CASES[name]["steps"]
    return {
        "case": name,
        "plain_us": ran[0] * scale,
        "one_kernel_us": ran[1] * scale,
        "times_faster": 1.0 / ran[2][len(ran[2]) // 2],
        "plain_compile_s": compiled[0],
        "one_kernel_compile_s": compiled[1],
    }


@command(pairs=5, cases=list(CASES), out=RESULTS / "one_kernel.json")
def main(args) -> None:
    rows = (row(name, args.pairs) for name in args.cases)
    collect(args.out, {"rows": rows}, machine=describe(), jax=jax.__version__)
