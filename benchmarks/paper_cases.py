"""The paper's five cases from its Table 6, and what its two simulators found (Table 7)."""

from dropper_jax import Scene, load_scene

#: The paper's Table 7: anchor tension [N], least, mean and largest, of OrcaFlex and of its adapted MoorDyn.
TABLE_7 = {
    "1": {"orcaflex": (0, 2986, 79442), "adapted_moordyn": (0, 2355, 16597)},
    "2": {"orcaflex": (0, 2696, 68756), "adapted_moordyn": (0, 2609, 12672)},
    "3": {"orcaflex": (0, 1605, 58753), "adapted_moordyn": (0, 293, 14024)},
    "4": {"orcaflex": (0, 1406, 1558), "adapted_moordyn": (0, 1380, 1535)},
    "5": {"orcaflex": (0, 5058, 71766), "adapted_moordyn": (0, 3319, 24173)},
}


def case(number: int, ratio: float = 0.1) -> Scene:
    """A case of the paper, from its positions. Cases 3 and 5 are turned by 90 degrees, so that waves travel in +x."""
    values = {"line_type.chain.damping_ratio": ratio}
    if number in (3, 5):
        values.update({"point.buoy.position": [0.0, 30.0, -4.43], "sea.waves.direction": 0.0})
    if number == 5:
        values["sea.current.direction"] = 0.0
    return load_scene(f"paper-case-{number}-table-6").with_values(values)
