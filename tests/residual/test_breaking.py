"""Links that break at the end of a step."""

from scene_parts import fixed, free, line_of, system

import dropper_jax as dj


def test_two_entries_that_are_due_at_one_link_break_it_once():
    points = [fixed("top", 0.0, 0.0, 0.0), free("end", 0.0, 0.0, -3.0, mass=10.0)]
    axial = {"law": "rope", "EA": 1e5, "damping": 100.0}
    line = line_of("rope", "top", "end", 3, 1.0, mass=1.0, nodes="shared", axial=axial)
    due = {"line": "rope", "load": 110.0}  # only the first link carries more: 12.5 kg
    last = {"line": "rope", "link": 3, "time": 0.1}
    run = dj.simulate(system([*points], [line], dt=0.01, duration=0.2, failure=[due, due, last, last]))
    assert [row["link"] for row in run.broken] == [1, 3]
