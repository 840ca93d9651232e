"""Check of an installation: versions, devices, cache, and known results."""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.one_kernel import tags_enabled
from dropper_jax.backend.programs import OPTIONS, stored_programs
from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.machine import available_memory, installed_version
from dropper_jax.base.read import Table
from dropper_jax.run.simulate import simulate

NEEDED = ("jax", "jaxlib", "numpy", "scipy", "matplotlib", "optax", "filelock", "platformdirs", "psutil", "tomlkit")
#: Packages of the extras, by extra.
EXTRAS = {
    "io": ("xarray", "h5netcdf", "h5py"),
    "sweep": ("zarr", "dask", "distributed"),
    "video": ("opencv-python-headless",),
    "moordyn": ("moordyn",),
    "sensitivity": ("SALib",),
    "fatigue": ("rainflow",),
}
#: Script that uses a program with programs stored in a folder, and reports whether it was loaded, and its result.
PROBE = """
import json, sys
import jax.numpy as jnp
from dropper_jax.backend.programs import cached_jit, store_programs, stored_programs
from dropper_jax.base.numerics import safe_norm
folder = store_programs(sys.argv[1])
found = float(cached_jit()(safe_norm)(jnp.asarray([60.0, 0.0, 80.0])))
loaded = folder is not None and stored_programs().loaded == 1
print(json.dumps({"folder": None if folder is None else str(folder), "loaded": loaded, "found": found}))
"""


@dataclass(frozen=True)
class Check:
    """A check against an exact result: whether it holds, and what was found in words."""

    name: str
    ok: bool
    found: str


@dataclass(frozen=True)
class System:
    """The machine: its free memory in bytes."""

    platform: str
    cores: int | None
    memory_bytes: float


@dataclass(frozen=True)
class Cache:
    """Folder of the compiled programs (None: off), their number and their size in bytes."""

    folder: str | None = None
    programs: int = 0
    bytes: int = 0


@dataclass(frozen=True)
class Installation:
    """The report of `dropper doctor`; its fields are the keys of the JSON object.

    Attributes:
        versions: by extra and package; None if a package is not installed.
        compiler_options: whether this version's compiler knows them.
    """

    versions: dict[str, dict[str, str | None]]
    system: System
    devices: list[str]
    float64: bool
    one_kernel: bool
    compiler_options: dict[str, bool]
    cache: Cache
    checks: list[Check]


def examine(repeats: int) -> Installation:
    """The installation, checked.

    Args:
        repeats: calls of one program whose bits are compared.
    """
    return Installation(
        versions=versions(),
        system=System(platform.platform(), os.cpu_count(), available_memory()),
        devices=[f"{device.platform}:{device.id} {device.device_kind}" for device in jax.devices()],
        float64=jnp.result_type(float) == jnp.float64,
        one_kernel=tags_enabled(),
        compiler_options={name: _has_option(name) for name in OPTIONS},
        cache=cache(),
        checks=[check_tension(), known_product(), repeated_bits(repeats), loads_stored_programs()],
    )


def versions() -> dict[str, dict[str, str | None]]:
    """Versions of required packages and of extras; None if a package is not installed."""
    found: dict[str, dict[str, str | None]] = {"needed": {"python": platform.python_version()}}
    for group, names in {"needed": ("dropper-jax", *NEEDED), **EXTRAS}.items():
        found.setdefault(group, {}).update((name, installed_version(name)) for name in names)
    return found


def cache() -> Cache:
    """Folder of the compiled programs, and their number."""
    stored = stored_programs()
    if stored is None:
        return Cache()
    folder = stored.folder.path
    sizes = [file.stat().st_size for file in folder.iterdir()]
    return Cache(str(folder), len(sizes), sum(sizes))


def _has_option(option: str) -> bool:
    """Whether this version's compiler has an option."""
    lowered = jax.jit(lambda x: x + 1.0).lower(0.0)
    try:
        lowered.compile({option: OPTIONS[option]})
    except jax.errors.JaxRuntimeError:
        return False
    return True


def check_tension() -> Check:
    """The tension of a conical pendulum is its weight over the sine of its angle below the horizontal,
    `m g/sin(theta)`."""
    allowed = 1e-4  # maximum relative error of the tension of the pendulum, due to its step
    solution = simulate("conical-pendulum", duration=1.0)
    error = np.max(np.abs(solution.tension / (GRAVITY / math.sin(math.pi / 8)) - 1.0))
    ok = solution.status == "ok" and error < allowed
    return Check("tension of a conical pendulum", ok, f"{error:.1e} off, {allowed:.0e} allowed")


def known_product() -> Check:
    """|I row|^2 of rows (i, 0, 0) is i^2: some versions of JAX give other values (jax-ml/jax issue 39103)."""
    i = jnp.arange(16_385, dtype=float)
    rows = jnp.stack([i, 0 * i, 0 * i], axis=1)
    squares = jax.jit(jax.vmap(lambda row: jnp.sum((jnp.eye(3) @ row) ** 2)))(rows)
    wrong = int(np.sum(np.asarray(squares) != np.arange(16_385.0) ** 2))
    return Check("products of matrices and vectors", not wrong, f"{wrong} of {len(i)} wrong")


def repeated_bits(calls: int) -> Check:
    """Whether one compiled program, called from two threads, always gives the same bits (jax-ml/jax issue 39741)."""
    x = jnp.linspace(0.0, 1.0, 4096).reshape(64, 64)
    program = jax.jit(lambda x: jnp.sum(jnp.tanh(x @ x), axis=0)).lower(x).compile()
    first = np.asarray(program(x)).tobytes()
    with ThreadPoolExecutor(2) as pool:
        wrong = sum(pool.map(lambda _: np.asarray(program(x)).tobytes() != first, range(calls)))
    return Check("bits of repeated calls", not wrong, f"{wrong} of {calls} calls differ")


def loads_stored_programs() -> Check:
    """Whether a program stored by one process is loaded by the next, with the same result."""
    name = "programs stored for the next start"
    with tempfile.TemporaryDirectory() as folder:
        first, second = (_probe(folder) for _ in range(2))
    if first is None or second is None:
        return Check(name, False, "a process that stores programs fails")
    if first["folder"] is None:
        return Check(name, False, "the folder of temporary files cannot be used")
    if not second["loaded"]:
        return Check(name, False, "stored, but not loaded: every start compiles")
    if first["found"] != second["found"] or abs(second["found"] - 100.0) >= 1e-9:
        return Check(name, False, f"{second['found']!r} instead of 100")
    return Check(name, True, "loaded again")


def _probe(folder: str) -> Table | None:
    """What a process prints that runs `PROBE` with the folder; None if it fails or takes longer than 120 s."""
    call = [sys.executable, "-c", PROBE, folder]
    try:
        done = subprocess.run(call, capture_output=True, text=True, check=True, timeout=120)
        return json.loads(done.stdout)
    except (subprocess.SubprocessError, ValueError):
        return None
