"""Files of motion and calibrations with wrong words, lines and ends."""

from __future__ import annotations

import re
from pathlib import Path
from random import Random

from .texts import NAMES, NUMBERS

TRC = """PathFileType\t4\t(X/Y/Z)\twalk.trc
DataRate\tNumFrames\tNumMarkers\tUnits
50\t3\t4\tmm
Frame#\tTime\ta\t\t\tb\t\t\tc\t\t\td\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2\tX3\tY3\tZ3\tX4\tY4\tZ4
1\t0.00\t1\t2\t3\t4\t5\t6\t7\t9\t8\t1\t0\t1
2\t0.02\t1\t3\t3\t4\t5\t7\t7\t8\t8\t1\t0\t2
3\t0.04\t2\t2\t3\t4\t6\t6\t7\t9\t9\t\t\t
"""

BVH = """HIERARCHY
ROOT a
{
  OFFSET 0 1 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT b
  {
    OFFSET 0 -4 0
    CHANNELS 3 Xrotation Yrotation Zrotation
    End Site
    {
      OFFSET 0 0 2
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.04
0 0 0 0 0 0 0 0 0
1 2 3 90 0 0 90 9 0
1 2 3 30 5 0 40 8 1
"""

ASF = """:version 1.10
:units
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    name b
    direction 0 -1 0
    length 2
    axis 0 0 90 XYZ
    dof rx
  end
  begin
    name c
    direction 1 0 0
    length 1
    axis 0 0 0 XYZ
    dof rx rz
  end
:hierarchy
  begin
    root b
    b c
  end
"""

AMC = """:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 0 0
b 0
c 0 0
2
root 1 2 3 0 0 90
b 30
c 0 20
"""

ANIPOSE = """a_x,a_y,a_z,a_error,a_ncams,a_score,b_x,b_y,b_z,b_ncams,c_x,c_y,c_z,c_ncams,fnum
1,2,3,0.5,3,0.9,4,5,6,2,7,9,8,2,0
1.5,2,3,0.5,3,0.9,4,5,7,2,7,8,8,2,1
,,,,,,4,5,7,2,7,8,8,2,2
"""

TOML = """[cam_0]
name = "left"
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [-0.1, 0.01, 0.001, 0.002, 0.0]
rotation = [0.0, 0.0, 1.57]
translation = [1.0, 2.0, 3.0]
"""

FILES = {"m.trc": TRC, "m.bvh": BVH, "m.asf": ASF, "m.amc": AMC, "m.csv": ANIPOSE, "m.toml": TOML}


def make(rng: Random, folder: Path) -> tuple[str, ...]:
    """Write all files, spoil one of them, and read it."""
    name = rng.choice([*FILES])
    for other, text in FILES.items():
        (folder / other).write_text(text)
    text = FILES[name]
    for _ in range(rng.randrange(1, 4)):
        text = spoiled_text(rng, text)
    (folder / name).write_bytes(text.encode("utf-8", "surrogatepass"))
    if name == "m.toml":
        camera = ("--set=camera.calibration=m.toml", "--set", f"camera.name={rng.choice('l0x')}")
        return ("fit", "views.h5", "-d", "dict.h5", "-o", "out.h5", "--set=threads=1", *camera)
    source = "m.amc" if name == "m.asf" else name
    if rng.random() < 0.5:
        return ("convert", source, "-o", rng.choice(("out.h5", "out.csv")))
    return ("learn-dict", source, "-o", "out.h5", "--set", "k=2", "--set", "iterations=2")


def spoiled_text(rng: Random, text: str) -> str:
    """Replace a word, cut the text off, or drop and repeat lines."""
    kind = rng.randrange(6)
    if kind < 3:
        words = re.split(r"(\s|,)", text)
        words[rng.randrange(len(words))] = rng.choice(NUMBERS + NAMES)
        return "".join(words)
    lines = text.split("\n")
    place = rng.randrange(len(lines))
    if kind == 3:
        return text[: rng.randrange(len(text) + 1)]
    lines[place : place + rng.randrange(2)] = rng.choice(([], lines[:2], [lines[place]] * 2))
    return "\n".join(lines)
