"""Evaluation of a run: its records, line tensions, snaps, fatigue, loads of anchors, and extremes of several runs."""
