"""The file of a search: everything that a restart needs, with a digest of the inputs that it belongs to."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.read import Table
from dropper_jax.base.records import without_keys
from dropper_jax.study.gradient_check import NOT_TRUSTED, GradientCheck
from fitting.farm.optimise.design_problem import DesignProblem
from fitting.farm.optimise.search_state import Search, Start
from fitting.sweep.effect_files import effect_digests


def save_search(file: Path | None, digest: str, search: Search, along: GradientCheck) -> None:
    """Write a search and its check of derivatives; nothing without a file."""
    if file is not None:
        table = {"site": digest, "along": along._asdict(), **asdict(search)}
        atomic_write(file, json.dumps(jsonable(table)))


def digest_inputs(problem: DesignProblem) -> str:
    """Digest of the inputs that a state belongs to: the whole site but its name, and the user's files of effects."""
    site = without_keys(problem.site.portable(), ("name", "description"))
    text = json.dumps(jsonable([site, effect_digests(problem.site.scene)]), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def load_search(file: Path | None, digest: str, problem: DesignProblem) -> tuple[Search, GradientCheck]:
    """The search of a state's file, with its check of derivatives; a new one without a file.

    Raises:
        SceneError: a file that is not a state, or belongs to other inputs.
    """
    if file is None or not file.exists():
        return Search(problem.start, problem.settings.reach), GradientCheck(np.nan, np.nan, np.nan, NOT_TRUSTED)
    try:
        table: Table = json.loads(file.read_text(encoding="utf-8"))
        site = table.pop("site")
        along: Table = table.pop("along")
        for key, x in along.items():
            if x is None:
                along[key] = np.nan
        for key in ("x", "best", "fixed"):
            if table[key] is not None:
                table[key] = np.array(table[key])
        if table["best_objective"] is None:
            table["best_objective"] = np.inf
        if table["before"] is not None:
            table["before"] = Start(**table["before"])
        found = Search(**table), GradientCheck(**along)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise SceneError(
            f"--state: {str(file)!r} is not a state of a search. Use one that it wrote, or a new file"
        ) from None
    if site != digest:
        raise SceneError(f"--state: {str(file)!r} belongs to another site or version of it. Use its own, or a new file")
    return found
