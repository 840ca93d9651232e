"""The report of a fit: what its tables say of the trace."""

from types import SimpleNamespace

import numpy as np

from fitting import Trace
from fitting.report.report import part_rows


def test_errors_along_a_trace_of_100_s_are_listed_up_to_its_end():
    t = np.arange(0.0, 100.0, 0.5)
    off = np.where(t < 50.0, 0.001, 0.003)[None, :, None]  # the last half is three times as far off
    windows = SimpleNamespace(
        run=np.zeros(1, int), theta=np.zeros_like(off), weight=np.ones_like(off), times=lambda: t[None]
    )
    solution = SimpleNamespace(evaluation=SimpleNamespace(theta=off))
    trace = Trace("long", t, np.zeros((len(t), 1)))
    rows = part_rows(SimpleNamespace(windows=windows, solution=solution, traces=[trace]))
    assert rows[-1][:2] == ("long", "tail 25-99.5 s")
    assert float(rows[-1][-1]) == float(f"{np.sqrt((50 * 0.001**2 + 100 * 0.003**2) / 150):.3g}")
