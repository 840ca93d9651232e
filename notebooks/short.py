"""Notebooks cut short for tests: which words of a script give way to which, so that the scripts hold none of it.

Every text on the left must stand in the script exactly once; a cell whose first line is given with `None` is left out.
"""

from __future__ import annotations

SHORT: dict[str, list[tuple[str, str | None]]] = {
    "1-first-dropper": [
        ("solution = dj.simulate(scene, duration=20.0)", "solution = dj.simulate(scene, duration=3.0)"),
        ("duration=20.0)\napart", "duration=3.0)\napart"),
    ],
    "2-what-accuracy-costs": [
        (', "theta:0.51", "theta:1", "theta_midpoint:0.51", "energy_momentum_4"]', "]"),
        ("range(5, 12)", "range(6, 9)"),
        ("span=2.0", "span=1.0"),
        ('("rattle", None), ("theta", 1.0)', '("theta", 1.0)'),
        ("duration=6.5", "duration=1.0"),
    ],
    "3-hard-cases": [
        ("(0.3, 1e-2, 1e-4, 1e-6)", "(1e-2,)"),
        ('(("energy_momentum", None), ("thesis_angles", 0.51))', '(("energy_momentum", None),)'),
        ("(0.005, 0.01, 0.02, 0.04, 0.06, 0.08)", "(0.05,)"),
        ("0.004, 6.0))", "0.004, 2.0))"),
    ],
    "4-damping-calibration": [
        ("DURATION = 16.0", "DURATION = 4.0"),
        (
            'dj.load_scene("dropper-release-a")',
            """dj.load_scene(
    {
        "run": {"dt": 0.01, "duration": 10.0},
        "point": [
            {"name": "pivot", "position": [0.0, 0.0, 0.0]},
            {"name": "end", "kind": "free", "position": [0.4, 0.0, 0.0]},
        ],
        "line": [{"name": "pair", "from": "pivot", "to": "end", "links": 2, "length": 0.2, "mass": 0.05}],
        "effects": {"weight": {}, "linear_damping": {"b_l": 0.004}, "quadratic_damping": {"b_q": 0.006}},
        "start": {"kind": "angles", "zero": "down", "polar": [1.9, 2.2]},
    }
)""",
        ),
        ("np.geomspace(0.25, 4, 61)", "np.array([0.5, 0.9, 1.0, 1.1, 2.0])"),
        ('method="shooting"', 'method="windows"'),
        ("for _ in range(25):", "for _ in range(3):"),
        ('    "Adam": {"method": GradientDescent("adam")},\n', ""),
        ("np.geomspace(0.2, 12, 13)", "np.geomspace(0.2, 12, 3)"),
        ("for _ in range(15):", "for _ in range(3):"),
    ],
    "5-sensitivity": [
        (', *(f"line.0.mass.{j}" for j in range(6))]', "]"),
        ("np.array([0.5, 1, 2, 4, 8, 12])", "np.array([0.5])"),
        ('"run.duration": 10.0', '"run.duration": 0.5'),
        ('"sobol", 128, 0', '"sobol", 8, 0'),
    ],
    "6-batch-sweep": [
        ('"run.duration": 10.0', '"run.duration": 1.0'),
        ("np.geomspace(0.0005, 0.02, 24)", "np.geomspace(0.0005, 0.02, 4)"),
        ("np.linspace(0.0, 0.01, 20)", "np.linspace(0.0, 0.01, 3)"),
        ('"duration": 60.0', '"duration": 2.0'),
        ("np.arange(0.5, 4.1, 0.5)", "np.array([1.0, 3.0])"),
        ("np.array([0.7, 2.8])", "np.array([1.4])"),
        ("seeds=10", "seeds=1"),
    ],
    "7-dropper-in-a-storm": [
        ("SECONDS = 120.0", "SECONDS = 2.0"),
        ("storm = dj.simulate(values, duration=SECONDS)", "storm = mild"),
    ],
    "8-longline": [
        ("SECONDS = 150.0", "SECONDS = 4.0"),
        ("(0.05, 0.02)", "(0.05,)"),
        ("duration=120.0", "duration=1.0"),
        ("t_tension > 15.0", "t_tension > 0.5"),
    ],
    "9-from-film-to-number": [
        ("LINKS, DURATION = 3, 12.0", "LINKS, DURATION = 2, 4.0"),
        ("fixed = fitted_scene", None),
    ],
    "10-design-a-farm": [
        ('{"duration": 60.0, "seeds": 1, "skip": 15.0}', '{"duration": 20.0, "seeds": 1, "skip": 10.0}'),
        ('"break_time": 30.0', '"break_time": 12.0'),
        ('plain["optimise"] = {"window": 45.0', None),
        ('variables = read_variables(plain["variable"]', None),
        ("[0.0, 0.5]", "[0.0]"),
        ('dj.load_scene("longline-rows")', 'dj.load_scene("longline-rows").with_values({"parameters.columns": 1})'),
    ],
    "11-winch-in-a-storm": [
        ("DT, SECONDS = 0.05, 60.0", "DT, SECONDS = 0.05, 22.0"),
        ("for seed in (4, 5, 6)]", "for seed in (4,)]"),
        ("STEPS = 24", "STEPS = 1"),
        ("for seed in (4, 5, 6, 7, 8, 9, 10):", "for seed in (4, 7, 8, 9):"),
    ],
    "12-rope-twin": [
        ("DURATION, SHAKE = 4.0, 3.0", "DURATION, SHAKE = 1.0, 0.8"),
        ("LINKS = (12, 24, 36)", "LINKS = (4, 6)"),
        ("STEPS = 12", "STEPS = 2"),
        ("[4, 8, 12]) / 12", "[2, 6]) / 6"),
        ("polynomials=8", "polynomials=4"),
        ("for seed in range(5):", "for seed in range(1):"),
    ],
}


def shortened(stem: str, cells: list[str]) -> list[str | None]:
    """The code of a notebook's cells for a short run; None for a cell that is left out.

    Raises:
        ValueError: a text of `SHORT` that does not stand in the notebook exactly once.
    """
    found: list[str | None] = list(cells)
    for old, new in SHORT[stem]:
        places = [i for i, text in enumerate(found) if text is not None and old in text]
        if len(places) != 1 or found[places[0]].count(old) != 1:
            raise ValueError(f"{stem}: {old!r} must stand in its code exactly once; mend notebooks/short.py")
        found[places[0]] = None if new is None else found[places[0]].replace(old, new)
    return found
