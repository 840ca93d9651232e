"""The type of options that are lists of pairs; importable without JAX."""


class Pairs:
    """The type of an option that is a list of pairs of names."""
