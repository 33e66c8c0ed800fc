"""Files that are not read are named as what they are, with what to give instead."""

import numpy as np
import pytest
import scipy.io

from shapefit.errors import InputError
from shapefit.io.detect import detect_format

MOT = "Coordinates\nversion=1\nnRows=2\nnColumns=3\ninDegrees=yes\nendheader\n"
STO = "walk\nnRows=2\nnColumns=2\nendheader\ntime\thip\n0\t1\n"
MOTIVE = "Format Version,1.23,Take Name,T1,Export Frame Rate,120\n\n,,Marker,Marker\n"
QUALISYS = "NO_OF_FRAMES\t4\nNO_OF_CAMERAS\t8\nMARKER_NAMES\ta\tb\n"
NTS = "' skulls\n1 12L 10 1 9999 DIM=2\na b c\n"
MORPHOLOGIKA = "[individuals]\n2\n[landmarks]\n5\n[dimensions]\n3\n[rawpoints]\n"
SLICER = "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n"
MARKUPS = '{"@schema": "https://x/markups-schema.json", "markups": [{"type": "F"}]}'
ULTRALYTICS = "path: coco\ntrain: images\nkpt_shape: [17, 3]\nnames:\n  0: person\n"
OBJ = "o car\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nend_header\n"

UNREAD = [
    ("a.mot", MOT, "joint angles", "TRC or C3D"),
    ("a.mot", MOT.replace("\n", ",,,\n"), "joint angles", "TRC"),
    ("angles.csv", MOT.replace("\n", ",,,\r\n"), "joint angles", "TRC"),
    ("a.sto", STO, "joint angles", "TRC"),
    ("a.mot", "motion\ndatacolumns 3\ndatarows 2\nendheader\n", "joint angles", "TRC"),
    ("take1.csv", MOTIVE, "OptiTrack Motive", "export the markers as TRC or C3D"),
    ("take1.csv", "\ufeff" + MOTIVE, "OptiTrack Motive", "TRC or C3D"),
    ("run.tsv", QUALISYS, "Qualisys", "export C3D"),
    ("run.txt", QUALISYS, "Qualisys", "export C3D"),
    ("a.nts", NTS, "NTSYS", "docs/formats.md"),
    ("a.dta", "1 3L 6 0 DIM=3\nx y z\n", "NTSYS", "docs/formats.md"),
    ("m.txt", MORPHOLOGIKA, "Morphologika", "docs/formats.md"),
    ("m.txt", MORPHOLOGIKA.title(), "Morphologika", "docs/formats.md"),
    ("f.fcsv", SLICER, "3D Slicer", "label, x, y, z"),
    ("f.mrk.json", MARKUPS, "3D Slicer", "label, x, y, z"),
    ("a.ply", PLY, "mesh .PLY", "docs/cars.md"),
    ("a.obj", OBJ, "mesh .OBJ", "docs/cars.md"),
    ("a.obj", "# Blender\nmtllib a.mtl\n" + OBJ, "mesh .OBJ", "docs/cars.md"),
    ("a.stl", "solid car\nfacet normal 0 0 1\n", "mesh .STL", "docs/cars.md"),
    ("a.off", "OFF\n3 1 0\n0 0 0\n", "mesh .OFF", "docs/cars.md"),
    ("a.glb", b"glTF\2\0\0\0", "mesh .glTF", "docs/cars.md"),
    ("a.xlsx", b"PK\3\4\0\0[Content_Types].xml", "spreadsheet", "save it as CSV"),
    ("a.xls", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "spreadsheet", "save it as CSV"),
    ("a.parquet", b"PAR1\x15\x04", "Parquet", "save it as CSV"),
    ("a.pkl", b"\x80\x04\x95", "a pickle", "numpy.save"),
    ("a.rds", b"\x1f\x8b\x08\0\0\0", "a file of R", "write.csv"),
    ("s.pts", "Version 1.0\n3\nS000 1 2 3\n", "IDAV Landmark", "docs/formats.md"),
    ("a.fbx", b"Kaydara FBX Binary  \0", "an FBX file", "export BVH"),
    ("a.mvnx", '<?xml version="1.0"?>\n<mvnx version="4">', "Xsens", "C3D or BVH"),
    ("data.yaml", ULTRALYTICS, "dataset of Ultralytics", "folder of its labels"),
    ("data.yml", "names:\n  0: cat\n" + ULTRALYTICS, "Ultralytics", "its labels"),
    ("a.xml", "<?xml?>\n<annotations>\n  <meta>", "of CVAT", "as COCO keypoints"),
    ("a.xml", '<?xml version="1.0"?>\n<dataset>', "XML", "write a table"),
]


@pytest.mark.parametrize(("name", "content", "kind", "fix"), UNREAD)
def test_files_that_are_not_read_are_named(tmp_path, name, content, kind, fix):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=rf"{name}: is .*{kind}.* not read; .*{fix}"):
        detect_format(path)


@pytest.mark.parametrize("version", ["5", "4"])
def test_matlab(tmp_path, version):
    path = tmp_path / "model.mat"
    scipy.io.savemat(path, {"W": np.ones((2, 5))}, format=version)
    with pytest.raises(InputError, match=r"model\.mat: is a MATLAB file.*matlab"):
        detect_format(path)


def test_a_config_is_no_landmarks(tmp_path):
    path = tmp_path / "fit.yaml"
    path.write_text("landmarks: views.csv\nmethod: convex\n")
    with pytest.raises(InputError, match=r"is a YAML file, not landmarks; .* as -c"):
        detect_format(path)
