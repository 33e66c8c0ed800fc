"""Trajectories that Vicon exports."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

HEADER = """Trajectories,,,,,,,
100,,,,,,,
,,Anna:LASI,,,Anna:RASI,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
"""


TRAJECTORIES = f"""{HEADER}7,0,1000,2000,3000,10,20,30
8,0,1001,2001,3001,,,

"""


DEVICES = "Devices\n1000\n,,Force,,\nFrame,Sub Frame,Fx,Fy,Fz\n,,N,N,N\n7,0,1,2,3\n\n"
"""Forces, which some files have before the trajectories."""


@pytest.mark.parametrize("before", ["\ufeff", DEVICES])
def test_trajectories_of_vicon(read_motion, before):
    shapes, notes = read_motion("walk.csv", before + TRAJECTORIES.replace("\n", "\r\n"))
    assert shapes.landmark_names == ("LASI", "RASI")
    assert shapes.items == ("walk/Anna/7", "walk/Anna/8")
    assert shapes.unit == "m"
    assert shapes.frame_rate == 100
    assert notes == ()
    first, second = shapes.shapes
    assert_allclose(first, [[1, 2, 3], [0.01, 0.02, 0.03]])
    assert np.isnan(second[1]).all()
