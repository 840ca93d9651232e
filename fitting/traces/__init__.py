"""Angle traces: the format that tracking writes and fitting reads, their conventions, and synthetic ones."""
