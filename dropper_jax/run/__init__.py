"""A run: steps to saved states, their work, warnings and errors, and its files."""
