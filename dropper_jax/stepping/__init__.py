"""Runs of many steps: choice of scheme and solver, halved steps, steps that follow an accuracy, saved states."""
