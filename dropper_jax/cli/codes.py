"""Exit codes of all commands."""

OK = 0
INVALID_INPUT = 2
#: A run or a search failed; its partial result is kept.
FAILED = 3
INTERRUPTED = 130
