"""`python -m dropper_jax`: the command line where `dropper` is not on the path."""

import sys

from dropper_jax.cli import main

sys.exit(main())
