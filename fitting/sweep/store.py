"""Results of a sweep on disk: a Zarr group for xarray, filled chunk by chunk, consistent after a kill at any moment.

A chunk's status is written last and atomically: only a chunk with a status counts as done.
"""

from __future__ import annotations

import json
import warnings
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import remove, remove_leftovers, unfinished_folder, unwritable
from dropper_jax.base.lock import Lock
from dropper_jax.base.store import Store, StoreStopped, request_differences
from dropper_jax.run.step_verdict import StepVerdict
from dropper_jax.run.storage import extra
from fitting.sweep.plan import DIMENSIONS, MARKS, QUANTITIES, STATUS, TRACES, Plan

if TYPE_CHECKING:
    import zarr

IDENTITY = "dropper_jax_sweep"
#: Attribute with the verdict on the step.
STEP_CHECK = "step_check"
PENDING = -1
#: Packages whose versions must match those of the existing part.
PACKAGES = ("jax", "jaxlib", "dropper-jax")
#: Number of differences listed in an error message.
MOST_DIFFERENCES = 3


def input_names(paths: list[str]) -> list[str]:
    """Names of the inputs in the store: the last part of a path if it is unique, otherwise the whole path."""
    short = [path.rsplit(".", 1)[-1] for path in paths]
    taken = {*QUANTITIES, *TRACES, *MARKS, "case", *chain.from_iterable(DIMENSIONS.values())}
    names = []
    for path, name in zip(paths, short, strict=True):
        if name.isdecimal() or name in taken or short.count(name) > 1:
            name = path
        names.append(name)
    return names


class SweepStopped(StoreStopped):
    """A sweep that had to stop (full disk); written chunks are complete, and the same call resumes."""


class SweepStore(Store[int, dict[str, np.ndarray]]):
    """The group of one plan: created if missing, resumed if it belongs to the same inputs.

    One process fills it and holds the lock until `close`.

    Args:
        mix_versions: resume a part made with other versions of JAX or of this package.

    Raises:
        SceneError: a folder that is not a sweep, is damaged, was made with other versions, is locked by another
            process, or belongs to other inputs, with the differences.
    """

    stopped = SweepStopped

    def __init__(self, path: str | Path, plan: Plan, versions: dict[str, str], mix_versions: bool = False) -> None:
        self.path = Path(path)
        self.plan = plan
        zarr = extra("zarr", "sweep")
        self.lock = Lock(self.path)
        try:
            remove_leftovers(self.path)
            self._is_new = not self.path.exists()
            if self._is_new:
                with unfinished_folder(self.path) as folder:
                    self._create(zarr.open_group(folder / "new", mode="w-"), versions)
                    (folder / "new").rename(self.path)
            self._open(versions, mix_versions)
        except BaseException as error:
            self.lock.release()
            if isinstance(error, OSError):  # messages of Zarr do not name the file
                raise unwritable(self.path, error) from None
            raise

    def remove_if_empty(self) -> None:
        """Remove the group if this process made it and no chunk is complete."""
        try:
            empty = self.counts()["pending"] == self.plan.cases
        except Exception:  # interrupted while the first chunk was written
            empty = False
        if self._is_new and empty:
            remove(self.path)

    def close(self) -> None:
        """Release the lock."""
        self.lock.release()

    def _open(self, here: dict[str, str], mixed: bool) -> None:
        """Open the group, if it is whole, belongs to the same inputs and was made with the same versions."""
        try:
            self.group = group = extra("zarr", "sweep").open_group(self.path, mode="r+")
            there = dict(json.loads(group.attrs[IDENTITY]))
        except Exception:  # any error of Zarr on a folder that is not a group
            raise SceneError(f"{self.path}: exists but is not a sweep. Use a new folder or a sweep to resume") from None
        found = request_differences(self.plan.identity(), there)
        if found:
            more = ""
            if len(found) > MOST_DIFFERENCES:
                more = f" and {len(found) - MOST_DIFFERENCES} more"
            raise SceneError(f"{self.path}: belongs to other inputs: {'; '.join(found[:MOST_DIFFERENCES])}{more}")
        self._check_versions(here, mixed)
        plan = self.plan
        try:
            whole = all(tuple(group[name].shape) == (plan.cases, *plan.inner_shape(name)) for name in plan.stored)
        except Exception:  # any error of Zarr on damaged metadata
            whole = False
        if not whole:
            raise SceneError(f"{self.path}: is damaged: its arrays are not those of the sweep. Use a new folder")

    def _check_versions(self, here: dict[str, str], mixed: bool) -> None:
        """Reject a group made with other versions; where mixing is allowed, record those of this process."""
        attributes = self.group.attrs
        there = attributes.get("versions")
        if not isinstance(there, dict):
            there = {}
        other = []
        for name in PACKAGES:
            if there.get(name) != here[name]:
                other.append(f"{name} {there.get(name)} there, {here[name]} here")
        if other and not mixed:
            raise SceneError(
                f"{self.path}: was started with other versions: {'; '.join(other)}. Use those versions, a new "
                "folder, or --mix-versions"
            )
        if other:
            earlier = attributes.get("versions_mixed")
            if not isinstance(earlier, list):
                earlier = []
            attributes["versions_mixed"] = [*earlier, here]

    def _create(self, group: zarr.Group, versions: dict[str, str]) -> None:
        """Create the arrays in a new group: inputs with their values, quantities and marks without."""
        plan = self.plan
        cases = plan.inputs(np.arange(plan.cases))
        names = input_names([axis.path for axis in plan.axes])
        for name, column, axis in zip(names, cases.T, plan.axes, strict=True):
            value = column.astype(axis.values.dtype)
            array = group.create_array(name, data=value, chunks=(plan.cases,), dimension_names=("case",))
            array.attrs.update({"units": axis.unit, "long_name": axis.path})
        number = {"dtype": plan.scene.run.dtype, "fill_value": np.nan}
        # stored raw, one byte per case: a status file is either whole or not readable
        raw = {"dtype": "int8", "fill_value": PENDING, "compressors": None}
        formats: dict[str, dict[str, Any]] = {"failed_at": number | {"dtype": "float64"}, "status": raw}
        for name, (unit, meaning) in plan.stored.items():
            inner = plan.inner_shape(name)
            array = group.create_array(
                name,
                shape=(plan.cases, *inner),
                chunks=(plan.chunk, *inner),
                dimension_names=("case", *DIMENSIONS.get(name, ())),
                **formats.get(name, number),
            )
            # xarray reads the inputs as coordinates
            array.attrs.update({"units": unit, "long_name": meaning, "coordinates": " ".join(names)})
        group["status"].attrs.update(
            {"flag_values": [PENDING, *range(len(STATUS))], "flag_meanings": " ".join(("pending", *STATUS))}
        )
        group.attrs.update({IDENTITY: json.dumps(plan.identity()), "versions": versions, "Conventions": "CF-1.11"})
        with warnings.catch_warnings():  # Zarr 3 supports it, though its specification does not have it yet
            warnings.simplefilter("ignore")
            extra("zarr", "sweep").consolidate_metadata(group.store)

    def has(self, key: int) -> bool:
        try:
            return bool(np.all(self.group["status"][self._cases(key)] != PENDING))
        except Exception:  # interrupted while it was written
            return False

    def read(self, key: int) -> dict[str, np.ndarray] | None:
        if self.has(key):
            return {name: self.group[name][self._cases(key)] for name in self.plan.stored}
        return None

    def write(self, key: int, found: dict[str, np.ndarray]) -> None:
        for name in self.plan.stored:
            self.group[name][self._cases(key)] = found[name]

    def _cases(self, key: int) -> slice:
        """The cases of a chunk."""
        cases = self.plan.cases_of(key)
        return slice(int(cases[0]), int(cases[-1]) + 1)

    @property
    def verdict(self) -> StepVerdict | None:
        """The verdict on the step of the sweep; None before it was checked."""
        there = self.group.attrs.get(STEP_CHECK)
        if isinstance(there, dict):
            return StepVerdict(there["status"], tuple(there["warnings"]))
        return None

    @verdict.setter
    def verdict(self, verdict: StepVerdict) -> None:
        self.group.attrs[STEP_CHECK] = {"status": verdict.status, "warnings": list(verdict.warnings)}

    def counts(self) -> dict[str, int]:
        """Cases by status."""
        status = self.group["status"][:]
        return {name: int(np.sum(status == code)) for code, name in enumerate(("pending", *STATUS), PENDING)}
