"""Angle traces: what tracking writes and fitting reads, how they count angles, and made-up ones."""
