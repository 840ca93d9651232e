"""What CableDyn says of the lazy-wave cable at rest: `python tests/moordyn/of_cabledyn.py` writes its numbers again.

It needs `pip install cabledyn` (0.3.0), whose finite elements have cubic Hermite shapes, unlike the links here.
Rods without mass and length are to CableDyn what they are in the deck: one line of three sections that bends as one.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

FILE = Path(__file__).parent / "decks" / "lazy_wave_cable_cabledyn.json"
#: Links of the deck's three lengths [m], and CableDyn's elements per link: even, so that a node is at the middle.
LENGTHS = (90.0, 45.0, 110.0)
LINKS = (30, 15, 36)
ELEMENTS = 12
DECK = """\
--- CableDyn Input File ---
lazy wave
--- LINE TYPES ---
TypeName Diam MassDenInAir EA BA EI Cd_n Cd_t Ca_n Ca_t
cable 0.20 70.0 5.0e8 0.0 1.0e4 1.2 0.0 1.0 0.0
buoy  0.40 70.0 5.0e8 0.0 1.0e4 1.2 0.0 1.0 0.0
--- POINTS ---
ID Type X Y Z
1 Coupled 0.0 0.0 -10.0
2 Fixed 180.0 0.0 -100.0
--- LINES ---
ID NodeA NodeB Outputs
1 1 2 -
--- SECTIONS ---
LineID LineType Length NumSegs
{sections}
--- OPTIONS ---
100.0 WtrDpth depth
9.81 g gravity
1025 rhoW density
3e6 kBot bed
0.05 dtM lines with EI need a step and an end; the static table is that of their start
0.1 TMax end
--- OUTPUTS ---
"FairTen1"
END
"""


def at_rest() -> dict[str, list]:
    """Positions [m] of the deck's nodes (82, 3), and tensions [N] at the middles of its links (81,)."""
    from cabledyn import CableDynDriver

    kinds = ("cable", "buoy", "cable")
    rows = zip(kinds, LENGTHS, LINKS, strict=True)
    sections = "\n".join(f"1 {kind} {length} {ELEMENTS * links}" for kind, length, links in rows)
    with tempfile.TemporaryDirectory() as folder:
        deck = Path(folder) / "cable.dat"
        deck.write_text(DECK.format(sections=sections))
        CableDynDriver().run(deck, Path(folder) / "cable")
        table = np.loadtxt(Path(folder) / "cable.static.out", skiprows=3)
    return {
        "positions": np.round(table[::ELEMENTS, 3:6], 4).tolist(),
        "tensions": np.round(table[ELEMENTS // 2 :: ELEMENTS, 6], 1).tolist(),
    }


if __name__ == "__main__":
    sys.exit(FILE.write_text(json.dumps(at_rest()) + "\n") == 0)
