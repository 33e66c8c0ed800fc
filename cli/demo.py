"""`demo`: sample detections of the package, lifted to 3D, and the page of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from shapefit.errors import as_typed, input_error

from .call import Call, Config, open_in_browser
from .commands import fit, view
from .options import COMMON, command, of_report
from .values import FILE

if TYPE_CHECKING:
    from shapefit.pipelines.result import Result

SAMPLES = "openpose"
"""The folder of sample detections, 36 frames of two people who walk."""

RESULT = "walk.h5"
PAGE = "walk.html"

FIT = (
    "shapefit fit {openpose} --keypoints body_25 --frame-rate 25"
    " --image-size 1280x720 --focal 1100 -o {result}"
)
VIEW = "shapefit view {result} -o {page}"


@command("demo", "shapefit demo", "shapefit demo first/ --open")
@click.argument("folder", default="shapefit-demo", type=FILE)
@click.option("--open", "show", is_flag=True, help="Open the page in a browser.")
@of_report
def demo(call: Call, folder: str, show: bool) -> int:
    """Lift sample detections of two people who walk, and write the page that shows
    them.

    The detections, 36 frames as OpenPose writes them, are copied into FOLDER, by
    default shapefit-demo. The commands that are run on them are shown: give these your
    own files. No network is needed.
    """
    target = Path(folder).absolute()
    samples = find_samples()
    check_has_only_demo_files(target, samples)
    code = call.follow(lift_samples(call, samples, target), "image")
    if show:
        open_in_browser(target / PAGE)
    return code


def find_samples() -> Path:
    """Return the folder of sample detections. Raises InputError where there is none."""
    from shapefit.config.paths import find_installed

    samples = find_installed("sample_data") / SAMPLES
    if not samples.is_dir():
        raise input_error(
            "demo",
            "this installation has no sample data",
            "install a whole one, or lift your own files: shapefit fit FILES",
        )
    return samples


def check_has_only_demo_files(folder: Path, samples: Path) -> None:
    """Raise InputError where a folder has files that no demo wrote; change nothing."""
    from shapefit.io.atomic import check_folder

    check_folder(folder)
    if not folder.is_dir():
        return
    copies = folder / SAMPLES
    ours = {folder / RESULT, folder / PAGE}
    ours |= {copies / path.name for path in samples.iterdir()}
    there = [*folder.iterdir()]
    if copies.is_dir():
        there = [*copies.iterdir(), *(path for path in there if path != copies)]
    others = [path for path in there if path not in ours or is_changed(path, samples)]
    if others:
        fault = f"has files that are not of the demo, such as {others[0].name}"
        raise input_error(folder, fault, "name a new folder: shapefit demo FOLDER")


def is_changed(path: Path, samples: Path) -> bool:
    """Whether a file differs from the sample of the same name, if there is one."""
    sample = samples / path.name
    return sample.is_file() and path.read_bytes() != sample.read_bytes()


def lift_samples(call: Call, samples: Path, folder: Path) -> Iterator[Result]:
    """Copy the samples into a folder, and show and run `fit` and `view` on them.

    Yields what their pipelines yield; frames of the page do not count as images.
    """
    import shutil

    from shapefit.config import FitConfig, ViewConfig
    from shapefit.io.atomic import staged_files
    from shapefit.pipelines.fit.fit import fit as fit_images
    from shapefit.pipelines.result import Result
    from shapefit.pipelines.view.run import write_page

    with staged_files(folder) as staging:
        # One by one: copytree would gather the errors of a full disk into a list.
        copies = staging / SAMPLES
        copies.mkdir()
        for sample in samples.iterdir():
            shutil.copyfile(sample, copies / sample.name)
    result = as_typed(folder / RESULT)
    line = FIT.format(openpose=as_typed(folder / SAMPLES), result=result)
    yield Result(line=f"$ {line}")
    yield from fit_images(read_command_line(call, fit, FitConfig, line))
    page = as_typed(folder / PAGE)
    line = VIEW.format(result=result, page=page)
    yield Result(line=f"$ {line}")
    for event in write_page(read_command_line(call, view, ViewConfig, line)):
        yield event._replace(done=0, note="")
    next_command = (
        f"open {page} in a browser, then lift your own files: shapefit fit FILES"
    )
    yield Result(rows=(("Next", next_command),))


def read_command_line(
    call: Call, of: click.Command, schema: type[Config], line: str
) -> Config:
    """Return the config that a command reads from a line typed in a shell."""
    from shlex import split

    _, name, *words = split(line)
    # under the parent, or its names of --help would be lost to the command
    parent = click.get_current_context().parent
    given = of.make_context(name, words, parent=parent).params
    keys = {key: value for key, value in given.items() if value and key not in COMMON}
    return replace(call, command=name).read_config(schema, keys)
