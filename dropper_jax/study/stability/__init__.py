"""A catalogue of hard cases, each with a measured numerical claim, compared with the thesis' schemes on the same
case."""

from dropper_jax.study.stability.case import Case, Outcome
from dropper_jax.study.stability.catalogue import all_cases, evaluate

__all__ = ["Case", "Outcome", "all_cases", "evaluate"]
