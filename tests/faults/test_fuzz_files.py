"""Damaged files of every kind: each is read or refused in one line, without a traceback, a hang or a silent NaN.

15 files by default; `make fuzz` and `make check` set FUZZ_FILES.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

for package in ("xarray", "h5netcdf", "zarr", "cv2"):
    pytest.importorskip(package)

FILES = int(os.environ.get("FUZZ_FILES", "15"))
#: More files than the default are others each time; the seed is printed where one fails.
SEED = 1 if FILES <= 60 else int.from_bytes(os.urandom(3))


@pytest.mark.slow
def test_damaged_files_are_refused_in_one_line_or_read(tmp_path):
    call = [sys.executable, str(Path(__file__).with_name("worker.py")), str(tmp_path), str(SEED), str(FILES)]
    done = subprocess.run(call, capture_output=True, text=True, errors="replace", check=False, cwd=tmp_path)
    last = (done.stderr.strip().splitlines() or [""])[-1]
    assert done.returncode == 0, f"ended by {done.returncode} in case {last}: {done.stderr[-2000:]}"
    found = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert found[-1] == {"done": FILES}
    assert found[:-1] == []
