"""The gallery: every script runs, and the notebook shows what it says."""

import json

import pytest
from PIL import Image

from tools.page_pictures import run_script

WRITTEN = {
    "openpose_to_opensim.sh": ["walk_person_1.trc", "walk_person_2.mot", "page.html"],
    "animal_from_deeplabcut.sh": ["walk.h5", "report/report.html", "page.html"],
    "mediapipe.py": ["walk.h5", "left_ankle.csv"],
    "cars_to_blender.sh": ["meshes/sedan_1/view_1.glb", "sheet.png", "page.html"],
    "python_arrays.py": ["ankles.png"],
}
"""Script -> some of the files that it writes."""


def test_the_gallery_is_what_runs_and_a_notebook(project):
    folder = project / "docs/gallery"
    names = {path.name for path in folder.iterdir()}
    assert names == {*WRITTEN, "README.md", "notebook.ipynb"}


@pytest.mark.parametrize("script", WRITTEN)
def test_every_script_has_a_picture(project, script):
    name = script.partition(".")[0]
    picture = project / f"docs/images/gallery/{name}.webp"
    assert Image.open(picture).width == 1000
    assert picture.stat().st_size < 200_000


@pytest.mark.slow
@pytest.mark.parametrize("script", WRITTEN)
def test_a_script_runs(script, tmp_path):
    run_script(script, tmp_path)
    for name in WRITTEN[script]:
        assert (tmp_path / name).stat().st_size > 0


def test_the_notebook_of_a_clone_has_no_outputs(project):
    text = (project / "docs/gallery/notebook.ipynb").read_text(encoding="utf-8")
    for cell in json.loads(text)["cells"]:
        assert not cell.get("outputs")


@pytest.mark.slow
def test_the_notebook_runs_and_shows_a_fit_a_plot_and_a_page(project, tmp_path):
    """As the site shows it."""
    import nbformat

    from tools.site import run_notebook

    executed = tmp_path / "run.ipynb"
    run_notebook(project / "docs/gallery/notebook.ipynb", executed)
    shown = {}
    for cell in nbformat.read(executed, as_version=4).cells:
        if cell.cell_type == "code" and cell.outputs:
            shown[cell.id] = cell.outputs[-1].get("data", {})
    assert "<svg" in shown["fit"]["text/html"]
    assert "image/png" in shown["plot"]
    assert "image/png" in shown["ankles"]
    assert "<th>trusted</th>" in shown["table"]["text/html"]
    assert shown["view"]["text/html"].startswith('<iframe sandbox="allow-scripts')
