"""Saved runs: `.npz`, labelled data (xarray, netCDF with CF-style names, units and provenance), and their loader.

Needs the extra `io` (xarray, h5netcdf), Zarr folders `sweep` too; `.npz` files need nothing beyond the package.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from dropper_jax.base.deferred_error_file import DeferredErrorFile
from dropper_jax.base.errors import SceneError, unreadable
from dropper_jax.base.files import (
    RUN_SUFFIXES,
    atomic_write,
    refuse_pipe,
    remove_leftovers,
    unfinished_folder,
    unwritable,
)
from dropper_jax.base.read import Plain, Table
from dropper_jax.base.records import without_none
from dropper_jax.base.store import read_archive, write_archive
from dropper_jax.quantities.variables import ARRAYS, DERIVED, SOME, VARIABLES
from dropper_jax.run import labelled
from dropper_jax.run.end_of_run import LAST, units
from dropper_jax.run.reopen import check_archive, reopen_run
from dropper_jax.run.row_store import release_pages
from dropper_jax.run.samples import Kind, Samples

if TYPE_CHECKING:
    import xarray

#: Prefix of the names of internal states of effects.
TAG = "own."
#: Group of a netCDF file with the final state.
RESTART = "restart"
#: Packages of a format, and the extras that install them.
PACKAGES = {
    ".nc": {"xarray": "io", "h5netcdf": "io", "h5py": "io"},
    ".zarr": {"xarray": "io", "zarr": "sweep"},
}
#: Attribute with the provenance (all data except arrays), as JSON.
PROVENANCE = "dropper_jax_run"
NOT_A_RUN = "not a saved run; allowed: a file written by `dropper run --out`"


def save_run(solution: Samples, path: str | Path) -> Path:
    """Write a run in the format of the suffix: netCDF (`.nc`), Zarr (`.zarr`), otherwise `.npz`; completely or not at
    all.

    Raises:
        SceneError: one line, if the suffix is another one, packages are missing, or the disk fails (netCDF, Zarr).
        OSError: the disk fails.
    """
    path = Path(path)
    if path.suffix.lower() not in ("", *RUN_SUFFIXES):
        raise SceneError(f"{path}: {path.suffix} is an unknown format; allowed: {', '.join(RUN_SUFFIXES)}")
    check_packages(path)
    write = {".nc": _write_netcdf, ".zarr": _write_zarr}.get(path.suffix.lower())
    if write is None:
        return _write_npz(solution, path)
    try:
        return write(solution, path)
    except (OSError, RuntimeError) as error:  # HDF5 reports its errors as either
        raise SceneError(f"{path}: {unwritable(path, error).strerror}") from None


def check_packages(path: Path) -> None:
    """Import the packages for the format of the suffix, so that a missing one is reported before the run starts."""
    for module, name in PACKAGES.get(path.suffix.lower(), {}).items():
        extra(module, name)


def check_target(path: Path) -> None:
    """Reject a file that a run could not be saved as, before it starts: a format without its package, a folder of
    something else."""
    check_packages(path)
    if path.suffix.lower() == ".zarr" and path.exists() and not _is_run_folder(path):
        raise SceneError(f"{path}: exists and is not a saved run. Use a new folder, or a saved run to replace")


def read_run(path: str | Path, kind: type[Kind]) -> Kind:
    """A saved run, as a `kind` of samples.

    Raises:
        SceneError: one line, if packages or the file are missing, or it is not a saved run.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    found = None
    check_packages(path)
    refuse_pipe(path, "run")
    with _without_complaints():
        try:
            if suffix == ".zarr":
                os.listdir(path)
            else:
                open(path, "rb").close()
        except OSError as error:
            raise unreadable(path, error) from None
        try:
            found = {".nc": _open_netcdf, ".zarr": _open_zarr}.get(suffix, _open_npz)(path)
        except SceneError:
            raise
        except Exception:  # any error of the libraries about damaged bytes; own checks are SceneErrors
            pass  # raised below: here it would hold the library's objects until complaints are heard again
        if found is None:
            gc.collect()  # those in circles complain when they are deleted
            raise SceneError(f"{path}: {NOT_A_RUN}")
    return reopen_run(path, *found, kind)


def _write_npz(solution: Samples, path: Path) -> Path:
    """Write arrays and provenance to an `.npz` file."""
    arrays = without_none({name: getattr(solution, name) for name in (*ARRAYS, *SOME)})
    arrays |= {TAG + name: values for name, values in solution.own.items()} | solution.last
    return write_archive(path, arrays, solution.provenance())


def _open_npz(path: Path) -> tuple[Plain, Table]:
    with open(path, "rb") as file:
        check_archive(file, path)
    meta, found = read_archive(path)
    return meta, _by_field({name: name for name in (*ARRAYS, *SOME)}, list(found), found.__getitem__)


def _by_field(
    columns: dict[str, str], names: list[str], read: Callable[[str], np.ndarray]
) -> dict[str, np.ndarray | dict[str, np.ndarray]]:
    """Arrays of a run by field; `columns` are their names in the file, `names` all names in it."""
    arrays = {key: read(name) for key, name in columns.items() if key not in SOME or name in names}
    own = {name.removeprefix(TAG): read(name) for name in names if name.startswith(TAG)}
    return {**arrays, "own": own, "last": {name: read(name) for name in names if name.startswith(LAST)}}


def extra(module: str, name: str) -> Any:
    """An optional package, or a one-line error with the extra that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise SceneError(f"{module} is not installed; needed: pip install 'dropper-jax[{name}]'") from None


def to_xarray(solution: Samples) -> xarray.Dataset:
    """The run as a dataset: time, node, link and axis are coordinates; angles [rad] are added for convenience."""
    xr = extra("xarray", "io")
    found: labelled.Variables = {}
    for key, one in (VARIABLES | DERIVED).items():
        values = getattr(solution, key)
        if values is not None:
            found[one.name] = (one.dimensions, values, {"units": one.unit, "long_name": one.meaning})
    for name, values in solution.own.items():
        inner = [f"{TAG}{name}.axis{i}" for i in range(1, values.ndim)]
        found[TAG + name] = (("time", *inner), values, {"long_name": f"internal state of effect {name}"})
    found |= labelled.derive_variables(solution)
    for name, values in solution.last.items():
        inner = [f"{name}_axis{i}" for i in range(values.ndim)]
        found[name] = (inner, values, {"units": units(name), "long_name": "part of the final state"})
    return labelled.add_attributes(xr.Dataset(found, labelled.coordinates(solution), _attributes(solution)))


def _attributes(solution: Samples) -> dict[str, Any]:
    used = solution.settings
    made_by = f"dropper-jax {solution.versions.get('dropper-jax', '?')}"
    return {
        "Conventions": "CF-1.11",
        "title": f"{solution.scene.name}: {solution.scene.description}".rstrip(": "),
        "source": f"{made_by}, {used.get('integrator')}, {solution.scene.run.steps_in_words}, {used.get('dtype')}",
        "history": f"written by {made_by}",
        "status": solution.status,
        PROVENANCE: json.dumps(solution.provenance()),
    }


def _from_xarray(dataset: xarray.Dataset) -> tuple[Plain, Table]:
    """Provenance and arrays of a dataset made by `to_xarray`."""
    columns = {key: one.name for key, one in VARIABLES.items()} | {"t": "time"}
    arrays = _by_field(columns, list(map(str, dataset.data_vars)), lambda name: np.asarray(dataset[name].values))
    return json.loads(dataset.attrs[PROVENANCE]), arrays


def _write_netcdf(solution: Samples, path: Path) -> Path:
    """Write netCDF-4; the final state, from which a run continues, is the group `restart`."""
    dataset, packed = labelled.for_file(to_xarray(solution))
    return atomic_write(path, lambda file: _dump(dataset, file, packed, vars(solution).values()))


def _dump(dataset: xarray.Dataset, file: BinaryIO, packed: labelled.Encoding, arrays: Iterable[Any]) -> None:
    """The dataset into an open file.

    HDF5 crashes if a write fails while it closes a file, so errors are hidden from HDF5 and raised afterwards.
    """
    target = DeferredErrorFile(file, lambda: release_pages(arrays))
    names = [name for name in dataset.data_vars if str(name).startswith(LAST)]
    of_restart = {key: packed[key] for key in packed if key in names}
    of_run = {key: packed[key] for key in packed if key not in names}
    dataset.drop_vars(names).to_netcdf(target, engine="h5netcdf", encoding=of_run)
    if names:
        restart = dataset[names].drop_attrs(deep=False).reset_coords(drop=True)
        restart.to_netcdf(target, engine="h5netcdf", encoding=of_restart, mode="a", group=RESTART)
    if target.refused is not None:
        raise target.refused


def _write_zarr(solution: Samples, path: Path) -> Path:
    """Write a Zarr folder with consolidated metadata; it replaces only a saved run."""
    check_target(path)
    dataset = to_xarray(solution)
    remove_leftovers(path)
    with unfinished_folder(path) as folder:
        part = folder / "run"
        dataset.to_zarr(part, mode="w-", zarr_format=2, consolidated=True)
        if path.exists():
            path.rename(folder / "before")
        part.rename(path)
    return path


def _is_run_folder(path: Path) -> bool:
    """Whether a Zarr folder is a saved run."""
    try:
        return PROVENANCE in json.loads((path / ".zattrs").read_text(encoding="utf-8"))
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _open_zarr(path: Path) -> tuple[Plain, Table]:
    with extra("xarray", "io").open_zarr(path, decode_times=False) as dataset:
        return _from_xarray(dataset)


def _open_netcdf(path: Path) -> tuple[Plain, Table]:
    xr = extra("xarray", "io")
    with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
        try:
            # the group of the final state, which older files store among their other variables
            restart = xr.load_dataset(path, engine="h5netcdf", group=RESTART)
        except (OSError, KeyError):  # a failed run has no final state
            return _from_xarray(dataset)
        return _from_xarray(dataset.assign(restart.data_vars))


@contextmanager
def _without_complaints() -> Iterator[None]:
    """Suppress messages about damaged bytes, which the error reports: of objects that cannot be closed (h5netcdf), and
    of unexpected files (Zarr)."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        sys.unraisablehook = before
