"""Read files as other programs do; print what they find as JSON.

Runs in the environment of `make interop`, without shapefit:
    .venv/interop/bin/python tests/interop/judge.py FILE...
"""

import json
import sys
from pathlib import Path


def read_storage(path):
    """OpenSim's two readers of tables."""
    import opensim

    opensim.Logger.setLevelString("error")
    storage = opensim.Storage(str(path))
    rows = [storage.getStateVector(row) for row in range(storage.getSize())]
    columns = storage.getColumnLabels().getSize() - 1
    table = opensim.TimeSeriesTable(str(path))
    return {
        "in_degrees": storage.isInDegrees(),
        "labels": [*table.getColumnLabels()],
        "storage_times": [row.getTime() for row in rows],
        "storage": [
            [row.getData().get(column) for column in range(columns)] for row in rows
        ],
        "table_times": [*table.getIndependentColumn()],
        "table": [
            table.getRowAtIndex(row).to_numpy().tolist()
            for row in range(table.getNumRows())
        ],
    }


def read_markers(path):
    """OpenSim's reader of markers."""
    import opensim

    opensim.Logger.setLevelString("error")
    table = opensim.TimeSeriesTableVec3(str(path))
    rows = [table.getRowAtIndex(row) for row in range(table.getNumRows())]
    return {
        "unit": table.getTableMetaDataString("Units"),
        "labels": [*table.getColumnLabels()],
        "times": [*table.getIndependentColumn()],
        "points": [
            [[row[column][axis] for axis in range(3)] for column in range(row.size())]
            for row in rows
        ],
    }


def read_c3d(path):
    import ezc3d

    file = ezc3d.c3d(str(path))
    point = file["parameters"]["POINT"]
    return {
        "unit": point["UNITS"]["value"][0],
        "labels": point["LABELS"]["value"],
        "points": file["data"]["points"][:3].transpose(2, 1, 0).tolist(),
    }


def read_bvh(path):
    import bvhio

    root = bvhio.readAsHierarchy(str(path))
    joints = [joint for joint, *_ in root.layout()]
    frames = bvhio.readAsBvh(str(path)).FrameCount
    points = []
    for frame in range(frames):
        root.loadPose(frame)
        points.append([list(joint.PositionWorld) for joint in joints])
    return {"labels": [joint.Name for joint in joints], "points": points}


def read_mesh(path):
    import trimesh

    mesh = trimesh.load(path, process=False, force="mesh")
    return {
        "faces": len(mesh.faces),
        "vertices": len(mesh.vertices),
        "bounds": mesh.bounds.tolist(),
        "watertight": bool(mesh.is_watertight),
    }


def read_poses(path):
    """movement's validator of files that its plugin opens, and a function of it."""
    import xarray
    from movement.kinematics import compute_velocity
    from movement.validators.datasets import ValidPosesInputs

    poses = xarray.open_dataset(path)
    ValidPosesInputs.validate(poses)
    velocity = compute_velocity(poses.position)
    return {
        "individuals": poses.individuals.values.tolist(),
        "labels": poses.keypoints.values.tolist(),
        "times": poses.time.values.tolist(),
        "fps": float(poses.fps),
        "points": poses.position.transpose(
            "individuals", "time", "keypoints", "space"
        ).values.tolist(),
        "speed": float(abs(velocity).max()),
    }


READERS = {
    ".nc": read_poses,
    ".mot": read_storage,
    ".sto": read_storage,
    ".trc": read_markers,
    ".c3d": read_c3d,
    ".bvh": read_bvh,
    ".obj": read_mesh,
    ".ply": read_mesh,
    ".glb": read_mesh,
}

if __name__ == "__main__":
    found = {name: READERS[Path(name).suffix](Path(name)) for name in sys.argv[1:]}
    json.dump(found, sys.stdout)
