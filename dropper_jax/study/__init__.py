"""Accuracy and cost of runs: accuracy against run time, hard cases, cost of each effect. Built on the functional
core."""
