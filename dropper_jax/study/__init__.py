"""Accuracy and cost of runs: accuracy against run time, cost of each effect. Built on the functional
core."""
