"""The scene: what a user describes, read and checked."""
