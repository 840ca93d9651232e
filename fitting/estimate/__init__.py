"""Estimators: windows of traces simulated with derivatives, and the optimisation of the parameters that fit them."""
