"""Each format gives back the points that it was made of, and what is wrong is named."""

import json
import pickle
from contextlib import suppress

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_landmarks, read_shapes
from tests.io.files import load_shapes
from tests.io.readers import made
from tests.io.readers.made import TRACKERS, landmark_names, read_images


@pytest.fixture
def points(rng):
    """Seven frames of two animals of four landmarks, one of which is missing once."""
    points = rng.integers(1, 600, (7, 2, 4, 2)).astype(float)
    points[3, 1, 2] = np.nan
    return points


@pytest.fixture
def confidence(rng):
    return np.round(rng.uniform(0.25, 1, (7, 2, 4)) * 64) / 64


@pytest.fixture
def read():
    return lambda path, **options: read_images(path, **options)[0]


@pytest.fixture
def problem(read):
    """The error of a file that must not be read, without its path."""

    def problem(path):
        with pytest.raises(InputError) as error:
            read(path)
        text = str(error.value)
        assert text.startswith(str(path)), text
        return text.removeprefix(str(path))

    return problem


JABS = "mouse_pose_est_v2.h5"


def by_animal(landmarks, many: int) -> np.ndarray:
    """Return points (frames, individuals, landmarks, 2) of items sorted by sequence."""
    return landmarks.as_columns().reshape(many, -1, 2, 4).transpose(1, 0, 3, 2)


@pytest.mark.parametrize("many", [1, 2])
@pytest.mark.parametrize(
    "name", [name for name in TRACKERS if "_pose_est_" not in name]
)
def test_points_confidence_and_names(tmp_path, points, confidence, read, name, many):
    path = tmp_path / name
    points, confidence = points[:, :many], confidence[:, :many]
    TRACKERS[name](path, points, confidence)
    found = read(path)
    np.testing.assert_array_equal(by_animal(found, many), points)
    seen = np.isfinite(points[..., 0])
    weights = np.where(seen, confidence, 0).transpose(1, 0, 2).reshape(-1, 4)
    np.testing.assert_allclose(found.confidence, weights)
    assert len(found.landmark_names) == 4
    assert found.landmark_names == landmark_names(4)
    assert len(set(found.sequences)) == many
    if name == "table.csv":
        who = "animal0/" if many == 2 else ""
        assert found.items[:2] == (f"table/{who}0", f"table/{who}1")
    assert found.unit == "px"
    assert found.y_axis == "down"


@pytest.mark.parametrize(
    "name", ["table.csv", "table.h5", "fixed.h5", "poses.nc", "poses.nwb"]
)
def test_three_dimensions_are_shapes(tmp_path, rng, confidence, name, problem):
    points = rng.normal(size=(7, 2, 4, 3))
    points[0, 0, 1] = np.nan
    TRACKERS[name](tmp_path / name, points, confidence)
    shapes = read_shapes([tmp_path / name], gaps=True)
    found = shapes.as_columns().reshape(2, 7, 3, 4).transpose(1, 0, 3, 2)
    np.testing.assert_array_equal(found, points)
    assert "of 3D points; give 2D landmarks" in problem(tmp_path / name)


def test_jabs(tmp_path, rng, read, problem):
    """Version 2, of one mouse, whose y comes first."""
    points = rng.integers(1, 600, (7, 1, 12, 2)).astype(float)
    points[3, 0, 2] = np.nan
    made.write_jabs(tmp_path / JABS, points, np.full((7, 1, 12), 0.5))
    found = read(tmp_path / JABS)
    np.testing.assert_array_equal(found.points, points[:, 0])
    assert found.confidence[3].tolist() == [0.5, 0.5, 0, *[0.5] * 9]
    assert found.items[0] == "mouse/0"
    assert found.landmark_names[:2] == ("NOSE", "LEFT_EAR")
    assert {*found.lines.ravel()} == {*range(12)}  # no landmark stands alone
    with h5py.File(tmp_path / JABS, "a") as file:
        values = file["poseest/points"][:]
        del file["poseest/points"]
        file["poseest/points"] = values[:, :9]
    assert "points of the shape (7, 9, 2), not of 12 land" in problem(tmp_path / JABS)


@pytest.mark.parametrize("version", [3, 4, 5])
def test_jabs_of_several_mice(tmp_path, rng, read, problem, version):
    """Their identities are kept where they change places, and where one is absent."""
    points = rng.integers(1, 600, (7, 2, 12, 2)).astype(float)
    points[3, 1] = np.nan
    path = tmp_path / f"mice_pose_est_v{version}.h5"
    made.write_jabs_of_several(path, points, np.full((7, 2, 12), 0.5), version=version)
    found = read(path)
    first = 0 if version == 3 else 1
    assert {*found.sequences} == {f"mice/{first}", f"mice/{first + 1}"}
    for who in range(2):
        rows = [one == f"mice/{first + who}" for one in found.sequences]
        present = [frame for frame in range(7) if (frame, who) != (3, 1)]
        assert found.column("frame")[rows].tolist() == present
        np.testing.assert_array_equal(
            found.as_columns()[rows].swapaxes(1, 2), points[present, who]
        )
    with h5py.File(path, "a") as file:
        name = "instance_embed_id" if version > 3 else "instance_track_id"
        for one in {name, "instance_track_id"}:
            del file[f"poseest/{one}"]
    assert "several mice without identities" in problem(path)


def test_a_mouse_without_an_identity_or_beyond_the_count_is_left_out(tmp_path, read):
    points = np.full((2, 2, 12, 2), 7.0)
    for version, name, values in (
        (4, "instance_embed_id", [[1, 2], [0, 1]]),
        (3, "instance_count", [2, 1]),
    ):
        path = tmp_path / f"m{version}.h5"
        made.write_jabs_of_several(path, points, points[..., 0], version=version)
        with h5py.File(path, "a") as file:
            file[f"poseest/{name}"][...] = values
        assert len(read(path)) == 3


def with_skeletons(path, change) -> None:
    """Change what the metadata of a .slp file say of its skeletons."""
    with h5py.File(path, "a") as file:
        attributes = file["metadata"].attrs
        about = json.loads(attributes["json"])
        change(about)
        attributes["json"] = json.dumps(about)


def test_a_skeleton_of_a_preset(tmp_path, points, confidence, read, problem):
    """SLEAP keeps its graph beside a description and a picture."""
    path = tmp_path / "labels.slp"
    made.write_slp(path, points, confidence)
    plain = read(path)

    def as_preset(about):
        (graph,) = about["skeletons"]
        preset = {"nx_graph": graph, "description": None, "preview_image": None}
        about["skeletons"] = [preset]

    with_skeletons(path, as_preset)
    found = read(path)
    assert found.landmark_names == plain.landmark_names
    assert found.lines.tolist() == plain.lines.tolist() == [[0, 1]]
    np.testing.assert_array_equal(found.landmarks, plain.landmarks)
    with_skeletons(path, lambda about: about["skeletons"][0].update(nx_graph={}))
    assert "a skeleton without nodes" in problem(path)


def test_two_skeletons_are_one_of_all_their_nodes(tmp_path, points, confidence, read):
    """The second animal has another skeleton, of which two nodes are of the first."""
    path = tmp_path / "labels.slp"
    made.write_slp(path, points, confidence)

    def add(about):
        about["nodes"] += [{"name": "horn"}, {"name": "hoof"}]
        ids = [{"id": number} for number in (4, 1, 5, 0)]
        links = [{"source": 4, "target": 5, "type": {"py/id": 1}}]
        about["skeletons"].append({"nodes": ids, "links": links})

    with_skeletons(path, add)
    with h5py.File(path, "a") as file:
        rows = file["instances"][()]
        rows["skeleton"] = rows["track"]
        file["instances"][...] = rows
    found = read(path)
    names = ("point0", "point1", "point2", "point3", "horn", "hoof")
    assert found.landmark_names == names
    assert found.lines.tolist() == [[0, 1], [4, 5]]
    first = found.as_columns()[[who.endswith("animal0") for who in found.sequences]]
    second = found.as_columns()[[who.endswith("animal1") for who in found.sequences]]
    np.testing.assert_array_equal(first[:, :, :4].swapaxes(1, 2), points[:, 0])
    assert np.isnan(first[:, :, 4:]).all()
    columns = [4, 1, 5, 0]
    np.testing.assert_array_equal(second[:, :, columns].swapaxes(1, 2), points[:, 1])


def test_movement_of_newer_versions(tmp_path, points, confidence, read):
    made.write_movement(tmp_path / "p.nc", points, confidence, plural=False)
    np.testing.assert_array_equal(by_animal(read(tmp_path / "p.nc"), 2), points)


def test_a_file_of_nwb_whose_series_differ_in_time(tmp_path, points, confidence, read):
    path = tmp_path / "p.nwb"
    made.write_nwb(path, points[:, :1], confidence[:, :1])
    with h5py.File(path, "a") as file:
        series = file["processing/behavior/animal0/point1"]
        for name in ("data", "confidence", "starting_time"):
            del series[name]
        series["data"], series["confidence"] = [[1.0, 2.0], [3.0, 4.0]], [0.5, 0.75]
        series["timestamps"] = np.array([2, 5]) / 30
    found = read(path)
    assert len(found) == 7
    seen = np.isfinite(found.as_columns()[:, 0, 1])
    assert np.flatnonzero(seen).tolist() == [2, 5]
    assert found.as_columns()[5, :, 1].tolist() == [3, 4]
    assert found.confidence[:, 1].tolist() == [0, 0, 0.5, 0, 0, 0.75, 0]
    for late, rate in (
        (0.19, pytest.approx(30)),
        (0.3, None),
    ):  # of the usual step
        with h5py.File(path, "a") as file:
            for number in (0, 2, 3):
                series = file[f"processing/behavior/animal0/point{number}"]
                for name in {"starting_time", "timestamps"} & series.keys():
                    del series[name]
                series["timestamps"] = np.append(np.arange(6), 6 + late) / 30
        assert read(path).frame_rate == rate


@pytest.mark.parametrize("stated", [False, True])
def test_axes_of_analysis_files(tmp_path, rng, read, stated):
    """Two landmarks, two tracks: the occupancy tells the orders apart, and stated axes
    win.
    """
    n = 2 if stated else 5
    points = rng.normal(size=(n, 2, 2, 2))
    confidence = rng.uniform(0.1, 1, (n, 2, 2))
    path = tmp_path / "p.analysis.h5"
    made.write_sleap_analysis(path, points, confidence)
    want = read(path)
    with h5py.File(path, "a") as file:
        del file["tracks"], file["point_scores"]
        file["tracks"], file["point_scores"] = points, confidence
        if stated:
            file["tracks"].attrs["dims"] = '["frame", "track", "node", "xy"]'
            file["point_scores"].attrs["dims"] = '["frame", "track", "node"]'
    found = read(path)
    np.testing.assert_array_equal(found.points, want.points)
    np.testing.assert_array_equal(found.confidence, want.confidence)


def test_a_skeleton_in_the_order_of_its_file(tmp_path, points, confidence, read):
    path = tmp_path / "p.slp"
    made.write_slp(path, points, confidence)
    with h5py.File(path, "a") as file:
        was, now = (
            json.dumps([{"id": n} for n in order])
            for order in ((0, 1, 2, 3), (2, 0, 3, 1))
        )
        attributes = file["metadata"].attrs
        attributes["json"] = attributes["json"].replace(was, now)
    found = read(path)
    assert found.landmark_names == ("point2", "point0", "point3", "point1")
    np.testing.assert_array_equal(by_animal(found, 2), points)


def test_old_slp_files_are_shifted_by_half_a_pixel(tmp_path, points, confidence, read):
    made.write_slp(tmp_path / "p.slp", points, confidence)
    with h5py.File(tmp_path / "p.slp", "a") as file:
        file["metadata"].attrs["format_id"] = 1.0
    np.testing.assert_array_equal(by_animal(read(tmp_path / "p.slp"), 2), points - 0.5)


@pytest.mark.parametrize("by", ["track", "from_predicted"])
def test_what_a_user_placed_wins(tmp_path, points, confidence, by):
    path = tmp_path / "p.slp"
    made.write_slp(path, points, confidence, users={2: 1, 5: 0})
    if by == "from_predicted":
        with h5py.File(path, "a") as file:
            table = file["instances"][:]
            users = table["instance_type"] == 0
            table["from_predicted"][users] = np.flatnonzero(users) - [1, 2]
            table["track"][users] = -1
            file["instances"][...] = table
    with open_landmarks([path]) as source:
        (found,) = source.batches(100)
        assert (
            "2 predicted instances replaced by those that a user placed"
            in source.notes[0]
        )
    assert len(found) == 14
    if by == "track":
        want = points.copy()
        want[2, 1] += 1
        want[5, 0] += 1
        np.testing.assert_array_equal(by_animal(found, 2), want)
    else:
        assert sorted(found.items)[-2:] == ["p/untracked/2/0", "p/untracked/5/0"]


def test_labels_of_images(tmp_path, points, confidence, read):
    path = tmp_path / "labels.h5"
    made.write_deeplabcut_fixed(path, points, confidence)
    assert read(path).items[1] == "labels/animal0/img00001"
    with h5py.File(path, "a") as file:
        folders = [f"labeled/{folder}/img{i}.png" for folder in "ab" for i in range(7)][
            :7
        ]
        del file["df_with_missing/axis1"]
        folders[-1] = "labeled/b/img4.png"
        file["df_with_missing/axis1"] = np.array(folders, "S")
    found = read(path)  # a folder is a video
    assert [item for item in found.items if item.startswith("labels/b")] == [
        "labels/b/animal0/img4",
        "labels/b/animal1/img4",
    ]


CSV = """scorer,,,me,me,me,me
bodyparts,,,nose,nose,tail,tail
coords,,,x,y,x,y
labeled-data,video,img1.png,1,2,3,4
labeled-data,video,img2.png,,,5,6
labeled-data,video,img3.png,7,8
"""


def test_paths_in_three_columns_and_rows_that_end_early(tmp_path, read):
    path = tmp_path / "labels.csv"
    path.write_text(CSV)
    found = read(path)
    assert found.items == ("labels/img1", "labels/img2", "labels/img3")
    missing = [[False, False], [True, False], [False, True]]
    assert np.isnan(found.as_columns()[:, 0]).tolist() == missing
    assert found.confidence is None


PLAIN = """scorer,net,net,net,net,net,net
bodyparts,a,a,a,b,b,b
coords,x,y,likelihood,x,y,likelihood
42150,12.5,-3,0.5,1e-3,2,1
42151,,,,5,6,0.25
42153,1,2,1,3,4,
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\n", "\r\n"),
        ("scorer", "\ufeffscorer"),
        (",", " , "),
        ("12.5", '"12.5"'),
        (",,,", ",nan,NA,"),
        ("12.5", "1.25e1"),
        ("4,\n", "4,\n\n\n"),
    ],
)
def test_csv_is_read_in_every_dress(tmp_path, read, old, new):
    (tmp_path / "p.csv").write_bytes(PLAIN.replace(old, new).encode())
    found = read(tmp_path / "p.csv")
    assert [item.split("/")[1] for item in found.items] == ["42150", "42151", "42153"]
    points = [[[12.5, 0.001], [-3, 2]], [[np.nan, 5], [np.nan, 6]], [[1, 3], [2, 4]]]
    np.testing.assert_array_equal(found.as_columns(), points)
    assert found.confidence.tolist() == [[0.5, 1], [0, 0.25], [1, 1]]


def test_a_landmark_that_an_individual_lacks_is_unseen(tmp_path, read):
    (tmp_path / "t.csv").write_text(
        "scorer,n,n,n,n,n,n\nindividuals,one,one,one,one,single,single\n"
        "bodyparts,a,a,b,b,c,c\ncoords,x,y,x,y,x,y\n0,1,2,3,4,5,6\n"
    )
    one, single = read(tmp_path / "t.csv").points
    np.testing.assert_array_equal(one, [[1, 2], [3, 4], [np.nan] * 2])
    np.testing.assert_array_equal(single, [[np.nan] * 2] * 2 + [[5, 6]])


def test_columns_of_other_tools_and_animals_that_were_not_found(tmp_path):
    """Ensembles add variances; newer versions write -1 for what they did not find."""
    (tmp_path / "t.csv").write_text(
        "scorer,n,n,n,n,n\nbodyparts,a,a,a,a,a\ncoords,x,y,likelihood,x_ens_var,y_ens_var\n"
        "0,1,2,0.5,9,9\n1,-1,-1,-1,9,9\n2,3,4,1,9,9\n3,7,8,-1,9,9\n"
    )
    with open_landmarks([tmp_path / "t.csv"]) as source:
        (found,) = source.batches(10)
        notes = "\n".join(source.notes)
    assert found.items == ("t/0", "t/2")
    assert found.as_columns()[:, :, 0].tolist() == [[1, 2], [3, 4]]
    assert "columns left out: x_ens_var, y_ens_var" in notes
    assert "2 items without a landmark left out" in notes


@pytest.mark.parametrize(
    "frames", [7, 2]
)  # of two the order of axes is open but for the rule
def test_an_analysis_file_of_tracks_and_nodes_alone(
    tmp_path, points, confidence, read, frames
):
    path = tmp_path / "tracks.h5"
    made.write_sleap_analysis(path, points[:frames], confidence[:frames])
    whole = read(path)
    with h5py.File(path, "a") as file:
        for name in set(file) - {"tracks", "node_names"}:
            del file[name]
    found = read(path)
    np.testing.assert_array_equal(found.points, whole.points)
    assert found.landmark_names == whole.landmark_names
    assert found.sequences == tuple(
        name.replace("animal", "track_") for name in whole.sequences
    )


@pytest.mark.parametrize(
    ("units", "unit"), [(["meters"], "m"), (["meters", "ft"], "unknown")]
)
def test_the_unit_of_shapes_in_nwb_is_that_of_all_series(tmp_path, rng, units, unit):
    points = rng.standard_normal((5, 1, 4, 3))
    made.write_nwb(tmp_path / "poses.nwb", points, np.ones((5, 1, 4)))
    with h5py.File(tmp_path / "poses.nwb", "a") as file:
        for number in range(4):
            data = file[f"processing/behavior/animal0/point{number}/data"]
            data.attrs["unit"] = units[number % len(units)]
            data.attrs["conversion"] = 0.001
    shapes, _ = load_shapes(tmp_path / "poses.nwb")
    assert shapes.unit == unit
    np.testing.assert_allclose(shapes.points, points[:, 0] / 1000)


@pytest.fixture
def write(tmp_path, points, confidence):
    def write(name):
        TRACKERS[name](tmp_path / name, points, confidence)
        return tmp_path / name

    return write


@pytest.mark.parametrize("name", TRACKERS)
def test_files_that_are_cut_off(write, name):
    path = write(name)
    data = path.read_bytes()
    for end in np.linspace(1, len(data) - 1, 6).astype(int):
        path.write_bytes(data[:end])
        with (
            suppress(InputError) if name.endswith(".csv") else pytest.raises(InputError)
        ):
            read_images(path)


def test_pickles_that_are_not_lists_of_names_are_refused(write, problem, tmp_path):
    path = write("table.h5")
    witness = tmp_path / "executed"
    evil = b"cos\nsystem\n(Vtouch " + str(witness).encode() + b"\ntR."
    for blob, found in (
        (evil, "asks for os.system, which is never executed here"),
        (pickle.dumps(np.zeros, 2), "asks for numpy"),
        (b"(lp999999999\n.", "cannot be read as a DeepLabCut HDF5 file"),
        (b"(lp0\n", "cannot be read as a DeepLabCut HDF5 file"),
    ):
        with h5py.File(path, "a") as file:
            file["df_with_missing/table"].attrs["values_block_0_kind"] = np.bytes_(blob)
        text = problem(path)
        assert found in text
    assert not witness.exists()


def test_a_filter_that_is_not_there(write, problem):
    path = write("tracks.analysis.h5")
    with h5py.File(path, "a") as file:
        values = file["tracks"][:]
        del file["tracks"]
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_chunk(values.shape)
        creation.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, (2, 2, 4, 64))  # blosc
        space = h5py.h5s.create_simple(values.shape)
        kind = h5py.h5t.IEEE_F64LE
        dataset = h5py.h5d.create(file.id, b"tracks", kind, space, creation)
        dataset.write_direct_chunk((0, 0, 0, 0), values.tobytes())
    text = problem(path)
    assert text.startswith(":/tracks: cannot be read (")
    assert text.endswith("write it again with gzip or without compression")


LOST = "instances of "


def two_tables(file):
    file.copy("df_with_missing", "tracks")


def edge_to_nowhere(file):
    file["edge_inds"][...] = [[0, 4]]


def bounding_boxes(file):
    file.attrs["ds_type"] = "bboxes"


def never_written(file):
    del file["edge_inds"]
    file.create_dataset("edge_inds", (10**7, 2), "i8", chunks=(1, 2))


def more_than_memory_holds(file):
    del file["tracks"], file["point_scores"]
    file.create_dataset("tracks", (2, 2, 4, 10**12), "f8", chunks=(2, 2, 4, 1 << 20))


def instances(column, rows, value, of="instances"):
    def change(file):
        table = file[of][:]
        table[column][:rows] = value
        file[of][...] = table

    return change


def no_start(file):
    file["processing/behavior/animal0/point1/starting_time"][()] = np.nan


def falling_times(file):
    series = file["processing/behavior/animal0/point1"]
    del series["starting_time"]
    series["timestamps"] = [0.0, 1, 2, 2, 3, 4, 5]


def no_poses(file):
    del file["processing/behavior"]


@pytest.mark.parametrize(
    ("name", "change", "found"),
    [
        ("table.h5", two_tables, "the tables df_with_missing, tracks; save one"),
        ("tracks.analysis.h5", edge_to_nowhere, "edge_inds points at no landmarks"),
        ("poses.nc", bounding_boxes, "bboxes, not poses"),
        (
            "tracks.analysis.h5",
            never_written,
            "the file holds 0 bytes; write its values",
        ),
        ("tracks.analysis.h5", more_than_memory_holds, "tracks"),
        (
            "labels.slp",
            instances("instance_id_end", 1, 99, "frames"),
            "frames of instances that it does not hold",
        ),
        ("labels.slp", instances("track", 2, 0), "item 'labels/animal0/0' is also at"),
        ("labels.slp", instances("track", 1, 7), LOST),
        ("labels.slp", instances("skeleton", 1, 3), LOST),
        ("labels.slp", instances("instance_type", 1, 9), LOST),
        ("labels.slp", instances("point_id_end", 1, 3), LOST),
        (
            "poses.nwb",
            no_start,
            "the times of processing/behavior/animal0/point1 do not",
        ),
        (
            "poses.nwb",
            falling_times,
            "the times of processing/behavior/animal0/point1 do not",
        ),
        ("poses.nwb", no_poses, "no PoseEstimation (ndx-pose), so no landmarks"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(write, problem, name, change, found):
    path = write(name)
    with h5py.File(path, "a") as file:
        change(file)
    assert found in problem(path)
