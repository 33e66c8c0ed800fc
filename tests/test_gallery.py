"""The scripts of docs/gallery run on the sample data, and each has its picture."""

import pytest

WRITTEN = {
    "openpose_to_opensim.sh": ["walk_person_1.trc", "walk_person_2.mot", "page.html"],
    "animal_from_deeplabcut.sh": ["walk.h5", "report/report.md", "page.html"],
    "mediapipe.py": ["walk.h5", "left_ankle.csv"],
    "cars_to_blender.sh": ["meshes/sedan_1/view_1.glb", "sheet.png", "page.html"],
    "python_arrays.py": ["ankles.png"],
}
"""Script -> some of the files that it writes."""


def test_every_script_is_short_and_has_a_picture(project):
    from PIL import Image

    folder = project / "docs/gallery"
    assert {path.name for path in folder.iterdir()} == {*WRITTEN, "README.md"}
    for script in WRITTEN:
        text = (folder / script).read_text(encoding="utf-8")
        assert len(text.splitlines()) < 60
        picture = project / "docs/images/gallery" / f"{script.partition('.')[0]}.webp"
        assert Image.open(picture).width == 1000
        assert picture.stat().st_size < 200_000


@pytest.mark.slow
@pytest.mark.parametrize("script", WRITTEN)
def test_a_script_runs(script, tmp_path):
    from tools.page_pictures import run_script

    run_script(script, tmp_path)
    for name in WRITTEN[script]:
        assert (tmp_path / name).stat().st_size > 0
