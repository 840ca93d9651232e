"""Scenes as MoorDyn inputs, and runs as tables of MoorDyn's channels."""
