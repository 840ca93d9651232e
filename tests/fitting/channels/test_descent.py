"""Steps of parameters: a stiffness follows its compliance, and reaches it in one step from far off."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.channels.problem import STEP_FACTOR, Problem, is_axial_stiffness
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import Direction

EA = Parameter("line_type.rope.EA", Direction({}, 1e6, linear=False), 1e6, 0.0, np.inf)
DRAG = Parameter("line_type.rope.cdn", Direction({}, 1.2, linear=True), 1.2, 0.0, np.inf)
PROBLEM = Problem(
    parameters=(EA, DRAG), data=None, scenes=(), of_run=(), plain=(), near=(), windows=SimpleNamespace(weight=None)
)


def test_axial_stiffness_alone_is_stepped_by_its_inverse():
    names = {"line.0.axial.EA": True, "line_type.rope.EA": True, "line_type.rope.EA@monday": True, "line.a.EA.3": True}
    names |= {"effects.bending.EI": False, "channel.EA.gain": False}
    assert {name: is_axial_stiffness(Parameter(name, EA.where, 1.0, 0.0)) for name in names} == names


@pytest.mark.parametrize("start", [6e5, 8e5, 2.5e6])
def test_one_step_solves_what_is_linear_in_the_compliance(start):
    """y = 1/EA, truth 1e6: Newton's step in EA is (1/EA - y) EA^2, which from 2e6 on would end at zero or below."""
    step = np.array([(1 / start - 1e-6) * start**2, 0.3])
    assert PROBLEM.after_step(np.array([start, 1.2]), step) == pytest.approx([1e6, 1.5])


def test_a_step_changes_a_number_by_no_more_than_the_factor_and_crosses_no_bound():
    values = np.array([1e6, 1.2])
    low, high = PROBLEM.step_bounds(values)
    assert PROBLEM.after_step(values, low)[0] == pytest.approx(1e6 / STEP_FACTOR)
    assert PROBLEM.after_step(values, high)[0] == pytest.approx(1e6 * STEP_FACTOR)
    assert (values + low)[1] == pytest.approx(0.0)
    assert (values + high)[1] == pytest.approx(1.2 * STEP_FACTOR)
