"""A folder of parts that was changed is found, though each part fits its digest."""

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import pytest
from shapefit.cli.main import run as run_command

from shapefit.io.layout import CONTENTS
from tests.pipelines.verify.conftest import is_accepted, reseal


def lines_of(folder: Path) -> list[dict[str, Any]]:
    text = (folder / "manifest.jsonl").read_text()
    return [json.loads(line) for line in text.splitlines()]


def write_lines(folder: Path, lines: list[dict[str, Any]]) -> None:
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (folder / "manifest.jsonl").write_text(text)


def double_with_a_line(folder):
    """The second part once more, as a third, with a line that fits."""
    shutil.copy(folder / "part-00001.h5", folder / "part-00002.h5")
    run, first, second = lines_of(folder)
    third = second | {"file": "part-00002.h5"}
    write_lines(folder, [run, first, second, third])


def double_as_other_rows(folder):
    shutil.copy(folder / "part-00001.h5", folder / "part-00002.h5")
    run, first, second = lines_of(folder)
    third = second | {"file": "part-00002.h5", "rows": [108, 152]}
    write_lines(folder, [run, first, second, third])


def double_in_place(folder):
    """The first part also as the second, with the size and counts of the first."""
    shutil.copy(folder / "part-00000.h5", folder / "part-00001.h5")
    run, first, _ = lines_of(folder)
    second = first | {"file": "part-00001.h5"}
    write_lines(folder, [run, first, second])


def size_of(line):
    """What a line says of the contents of its part."""
    return {key: line[key] for key in ("bytes", "images", "digest")}


def swap_with_sizes(folder):
    one = folder / "part-00000.h5"
    two = folder / "part-00001.h5"
    aside = folder / "aside"
    one.rename(aside)
    two.rename(one)
    aside.rename(two)
    run, first, second = lines_of(folder)
    write_lines(folder, [run, first | size_of(second), second | size_of(first)])


def cut_with_its_line(folder):
    (folder / "part-00001.h5").unlink()
    run, first, _ = lines_of(folder)
    write_lines(folder, [run, first])


def cut_the_first_with_its_line(folder):
    (folder / "part-00000.h5").unlink()
    run, _, second = lines_of(folder)
    write_lines(folder, [run, second])


def keep_images(file: h5py.File, kept: int) -> None:
    """Cut a result after so many images, and its transforms after theirs."""
    count = len(file["item"])
    transforms = int(file["transform_count"][:kept].sum())
    for name, node in file.items():
        if node.shape[:1] == (count,):
            node.resize(kept, axis=0)
        elif name in ("transform_atom", "active_transforms"):
            node.resize(transforms, axis=0)


def cut_images(folder):
    """The last images of a part, as if it had never had them, sealed anew."""
    part = folder / "part-00001.h5"
    with h5py.File(part, "r+") as file:
        kept = len(file["item"]) - 4
        keep_images(file, kept)
        reseal(file)
        digest = file.attrs[CONTENTS]
    run, first, second = lines_of(folder)
    size = part.stat().st_size
    changed = {"bytes": size, "images": kept, "digest": digest}
    write_lines(folder, [run, first, second | changed])


def lose_the_seal(folder):
    part = folder / "part-00001.h5"
    with h5py.File(part, "r+") as file:
        del file.attrs[CONTENTS]
    size = part.stat().st_size
    run, first, second = lines_of(folder)
    write_lines(folder, [run, first, second | {"bytes": size}])


LIES = (
    double_with_a_line,
    double_as_other_rows,
    double_in_place,
    swap_with_sizes,
    cut_with_its_line,
    cut_the_first_with_its_line,
    cut_images,
    lose_the_seal,
)


@pytest.mark.parametrize("lie", LIES, ids=[lie.__name__ for lie in LIES])
def test_a_changed_folder_is_found_without_landmarks(folder, verify, dictionaries, lie):
    assert verify(folder, dictionaries["cars"]).failures == {}
    lie(folder)
    assert not is_accepted(verify, folder, dictionaries["cars"], [])


def test_a_part_alone_is_compared_with_its_rows(
    folder, verify, dictionaries, landmarks
):
    part = folder / "part-00001.h5"
    found = verify(part, dictionaries["cars"], [landmarks["cars"]])
    assert found.failures == {}
    assert found.done == 44


def test_what_is_converted_is_not_sealed(folder, verify, dictionaries, tmp_path):
    """It is not what `fit` wrote: an edited result does not get a digest that holds."""
    joined = tmp_path / "joined.h5"
    status = run_command(["convert", str(folder), "-o", str(joined), "-q"])
    assert status == 0
    found = verify(joined, dictionaries["cars"])
    assert found.failures == {}
    assert found.data["sealed"] == 0
