"""Formats of trackers of animals: HDF5 and CSV files, one for each video.

Several are HDF5 files of the same suffix, so that their recognisers share one look into the file.
"""

from __future__ import annotations

from shapefit.io.foreign.file_format import FileFormat

_ROOM = "shapefit.io.trackers"
_RECOGNITION = f"{_ROOM}.recognition"

FORMATS: dict[str, FileFormat] = {
    "deeplabcut-csv": FileFormat(
        title="a DeepLabCut or Lightning Pose CSV",
        suffixes=(".csv",),
        recogniser=f"{_RECOGNITION}:is_deeplabcut_csv",
        recorder=f"{_ROOM}.deeplabcut_csv:record",
        records=("landmarks", "shapes"),
    ),
    "deeplabcut-h5": FileFormat(
        title="a DeepLabCut HDF5 file",
        suffixes=(".h5", ".hdf5"),
        recogniser=f"{_RECOGNITION}:is_deeplabcut_hdf5",
        recorder=f"{_ROOM}.deeplabcut_hdf5:record",
        records=("landmarks", "shapes"),
    ),
    "jabs-h5": FileFormat(
        title="a JABS pose file",
        suffixes=(".h5",),
        recogniser=f"{_RECOGNITION}:is_jabs",
        recorder=f"{_ROOM}.jabs:record",
        records=("landmarks",),
    ),
    "movement-netcdf": FileFormat(
        title="a movement netCDF file",
        suffixes=(".nc", ".nc4"),
        recogniser=f"{_RECOGNITION}:is_movement",
        recorder=f"{_ROOM}.movement:record",
        records=("landmarks", "shapes"),
    ),
    "nwb-ndx-pose": FileFormat(
        title="an NWB file",
        suffixes=(".nwb",),
        recogniser=f"{_RECOGNITION}:is_nwb",
        recorder=f"{_ROOM}.nwb:record",
        records=("landmarks", "shapes"),
    ),
    "sleap-analysis-h5": FileFormat(
        title="a SLEAP analysis file",
        suffixes=(".h5", ".hdf5"),
        recogniser=f"{_RECOGNITION}:is_sleap_analysis",
        recorder=f"{_ROOM}.sleap_analysis:record",
        records=("landmarks",),
    ),
    "sleap-slp": FileFormat(
        title="a SLEAP .slp file",
        suffixes=(".slp",),
        recogniser=f"{_RECOGNITION}:is_slp",
        recorder=f"{_ROOM}.sleap_labels:record",
        records=("landmarks",),
    ),
}
