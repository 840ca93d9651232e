"""Estimators: windows of traces simulated with derivatives, and what finds the parameters that fit them."""
