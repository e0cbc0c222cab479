"""The questions of ``raacmm arm``: the lengths of an arm, and which of them matter."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.app._cells import parse_number
from sklearn_raacmm.arm import Arm

_PICTURE = r"""
           elbow: axes 2 and 3 cross, or pass at the elbow offset
              o
    upper    / \    fore
            /   \
           o     o--( probe
   shoulder|     wrist: axes 4 and 5 cross, or pass at the wrist offset
    height |
         =====  base: axis 1 upright, axis 2 across it
"""
_QUESTIONS = (
    ("shoulder", "height of the shoulder above the base"),
    ("upper", "shoulder to elbow"),
    ("fore", "elbow to wrist"),
    ("probe", "wrist to the centre of the probe"),
    ("elbow_offset", "how far axes 2 and 3 pass each other, 0 if they cross"),
    ("wrist_offset", "how far axes 4 and 5 pass each other, 0 if they cross"),
)
_ADVICE = """Shoulder to elbow and elbow to wrist decide the scale of the arm: take them from a
drawing, to half a millimetre, or measure a known distance. The height of the shoulder only says
where the origin is. Calibration finds all others, offsets too, to hundredths of a millimetre."""


def ask_for_an_arm():
    """Arm whose lengths are asked for one by one."""
    print(_PICTURE)
    print(_ADVICE)
    layout = input("Layout, 2-2-2 or 2-2-3: ").strip()
    lengths = {name: parse_number(input(f"{text}, mm: ")) for name, text in _QUESTIONS}
    return Arm.from_lengths(layout, **lengths)
