"""The names that `fitting` offers: there when asked for, and not before."""

import subprocess
import sys

import pytest

import fitting
from fitting import fit


def test_nothing_is_loaded_before_it_is_asked_for():
    """A command line that only lists its commands waits for no estimator."""
    code = "import sys, fitting, fitting.cli.fit, fitting.cli.sweep, fitting.cli.sensitivity, fitting.cli.track; "
    code += "print(*(name for name in sys.modules if name.startswith('fitting.') and '.cli' not in name))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == ""


def test_public_names_are_those_of_their_modules():
    assert fitting.fit is fit
    assert set(fitting.__all__) <= set(dir(fitting))
    for name in fitting.__all__:
        assert getattr(fitting, name).__name__ == name
    with pytest.raises(AttributeError, match="'fitts'"):
        fitting.fitts  # noqa: B018
