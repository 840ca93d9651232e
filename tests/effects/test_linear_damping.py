"""Linear damping against its definition; its decay in time stands with the pendulum."""

import numpy as np


def test_linear_damping_is_minus_b_v_per_node(instant):
    model, k = instant({"linear_damping": {"b_l": [0.1, 0.2, 0.3]}})
    np.testing.assert_allclose(model.force(k), -np.array([[0.1], [0.2], [0.3]]) * np.asarray(k.v), rtol=1e-14)
