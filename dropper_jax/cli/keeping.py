"""Storage of running simulations: scratch folders next to their files, recovery of killed runs, disk errors."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import PART, part_prefix, remove, unwritable
from dropper_jax.cli.faults import defer_signals
from dropper_jax.cli.output import print_line

if TYPE_CHECKING:
    from dropper_jax.run.simulate import Solution


@contextmanager
def scratch_beside(out: Path | None) -> Iterator[Path | None]:
    """A temporary empty folder next to the output file of a run; None if the run is not saved."""
    if out is None:
        yield None
        return
    try:
        folder = Path(tempfile.mkdtemp(dir=out.parent, prefix=part_prefix(out), suffix=PART))
    except OSError as error:
        raise unwritable(out, error) from None
    try:
        yield folder
    finally:
        remove(folder)


def recover_leftovers(out: Path | None) -> None:
    """Recover and report the files of a killed run next to `out`."""
    if out is None:
        return
    from dropper_jax.run.recovery import recover

    for line in recover(out):
        print_line(f"warning: {line}")


def save_or_report(solution: Solution, out: Path | None) -> str | None:
    """Save a run; if this fails, save it in the folder for temporary files, and return the error in one line."""
    if out is None:
        return None
    with defer_signals():
        try:
            solution.save(out)
            return None
        except (SceneError, OSError) as error:
            reason = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else str(error)
        reason = " ".join(reason.split())
        with suppress(OSError):
            folder = Path(tempfile.mkdtemp(prefix="dropper-"))
            try:
                return f"{reason}; the run was saved to {solution.save(folder / f'{out.stem}.npz')}"
            except (SceneError, OSError):
                remove(folder)
    return f"{reason}; the run could not be saved"
