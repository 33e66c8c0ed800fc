"""`fit --live`: a pipe that stays open gives each shape when its item is complete."""

import csv
import io
import select
import signal
import subprocess
import sys
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.cli.conftest import run_in

COMMAND = Path(sys.executable).with_name("shapefit")

PATIENCE = 120
"""Seconds until rows that do not come are missed, on a busy machine."""


@pytest.fixture(scope="module")
def images(world):
    """The header of a table of cars, and the rows of each image, as lines."""
    text = world.images("cars").with_suffix(".csv").read_text()
    header, *rows = text.splitlines(keepends=True)
    items = {}
    for row in rows:
        items.setdefault(row.partition(",")[0], []).append(row)
    return header, items


def open_fit(world, method="mean-shape"):
    """Return a process that fits cars between two pipes that stay open."""
    of_cars = str(world.dictionary("cars"))
    return subprocess.Popen(
        [COMMAND, "fit", "-d", of_cars, "-o", "-", "-", "--live", "--method", method],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def quoted(row):
    """Return a row whose item has a comma, and so quotes."""
    item, _, rest = row.partition(",")
    return f'"a, {item}",{rest}'


def send(process, lines):
    process.stdin.write("".join(lines).encode())


def read_rows(process, count):
    """Return the next rows of a process, which must come while its input is open."""
    text = b""
    while text.count(b"\n") < count:
        ready, _, _ = select.select([process.stdout], [], [], PATIENCE)
        assert ready, "no rows came"
        text += process.stdout.read(1 << 16)
    return text.decode().splitlines()


def finish(process):
    """End the input; return the remaining output, what is told, and the exit code."""
    process.stdin.close()
    output = process.stdout.read().decode()
    told = process.stderr.read().decode()
    process.stdout.close()
    process.stderr.close()
    return output, told, process.wait()


def test_an_item_is_written_before_the_input_ends(world, images):
    header, items = images
    (first, second, third), p = [*items.values()][:3], len(next(iter(items.values())))
    process = open_fit(world)
    send(process, [header, *first[:10]])
    send(process, first[10:])  # complete: all landmarks of the dictionary have come
    assert len(read_rows(process, 1 + p)) == 1 + p
    second = [quoted(row) for row in second]
    send(process, second[1:])  # which lacks one, and is complete as another begins
    assert select.select([process.stdout], [], [], 1)[0] == []
    send(process, third[:1])
    named = [row.split('"')[1] for row in read_rows(process, p)]
    assert named == [f"a, {[*items][1]}"] * p
    send(process, third[1:2])
    output, told, code = finish(process)
    assert [row.split(",")[0] for row in output.splitlines()] == [[*items][2]] * p
    # the last of three has two landmarks, of which there is no shape
    assert "3 images" in told
    assert code == 1


def test_a_reader_that_stops_reading_ends_it(world, images):
    header, items = images
    process = open_fit(world)
    process.stdout.close()
    send(process, [header, *next(iter(items.values()))])
    assert b"rror" not in process.stderr.read()
    process.stdin.close()
    process.stderr.close()
    assert process.wait() == 128 + signal.SIGPIPE


def test_an_interrupt_ends_it_and_leaves_what_was_written(world, images):
    header, items = images
    process = open_fit(world)
    rows = next(iter(items.values()))
    send(process, [header, *rows])
    assert len(read_rows(process, 1 + len(rows))) == 1 + len(rows)
    process.send_signal(signal.SIGINT)
    assert process.wait() == 128 + signal.SIGINT
    output, told, _ = finish(process)
    assert output == ""
    assert "Interrupted" in told


def fit_of_cars(world, folder, method, *arguments, text=""):
    of_cars = world.dictionary("cars")
    done = run_in(
        folder, "fit", "-q", "-d", of_cars, "-o", "-", "--method", method, *arguments,
        text=text,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers_of(text):
    """Return the names of a table, and its numbers (n, 3)."""
    rows = [*csv.reader(io.StringIO(text))]
    return [row[:2] for row in rows], np.array([row[2:] for row in rows[1:]], float)


@pytest.mark.parametrize("method", ["mean-shape", "convex", "convex+refine"])
def test_numbers_are_those_of_a_file(world, images, tmp_path, method):
    header, items = images
    few = [*items.values()][:5]
    # an item whose name has a comma, and so quotes; and one without a row
    few[1] = [quoted(row) for row in few[1]]
    few[2] = few[2][1:]
    text = "".join([header, *chain(*few)])
    (tmp_path / "all.csv").write_text(text)
    whole = fit_of_cars(world, tmp_path, method, "all.csv")
    live = fit_of_cars(world, tmp_path, method, "-", "--live", text=text)
    names, numbers = numbers_of(whole)
    live_names, live_numbers = numbers_of(live)
    assert live_names == names
    # of the convex program images of a file start from their neighbours' solutions
    assert_allclose(live_numbers, numbers, rtol=1e-3, atol=1e-2)
    if method == "mean-shape":
        assert live == whole
    (tmp_path / "one.csv").write_text("".join([header, *few[4]]))
    alone = fit_of_cars(world, tmp_path, method, "one.csv").splitlines()[1:]
    assert live.splitlines()[-len(alone) :] == alone


def test_options_change_what_comes_as_in_a_file(world, images, tmp_path):
    header, items = images
    few = [*items.values()][:2]
    named = [row.replace("left_front_light_top_outer", "lamp") for row in chain(*few)]
    text = "".join([header, *named])
    (tmp_path / "all.csv").write_text(text)
    keys = ("--set", "rename={lamp: left_front_light_top_outer}", "--set", "y_axis=up")
    whole = fit_of_cars(world, tmp_path, "mean-shape", "all.csv", *keys)
    live = fit_of_cars(world, tmp_path, "mean-shape", "-", "--live", *keys, text=text)
    assert live == whole


def test_an_item_that_returns_is_an_error_and_what_was_written_stays(
    world, images, tmp_path
):
    header, items = images
    name, (first, second) = next(iter(items)), [*items.values()][:2]
    text = "".join([header, *first, *second[:5], first[0]])
    of_cars = world.dictionary("cars")
    done = run_in(tmp_path, "fit", "-d", of_cars, "-o", "-", "-", "--live", text=text)
    assert done.returncode == 2
    line = 1 + len(first) + 5 + 1
    fault = f"standard input:{line}: item '{name}' returns after its shape"
    assert fault in done.stderr
    assert "leave out --live" in done.stderr
    assert done.stdout.splitlines()[1].startswith(name)


def test_landmarks_that_the_first_item_lacks(world, images, tmp_path):
    header, items = images
    first, second = [*items.values()][:2]
    of_cars = world.dictionary("cars")
    ear = second[0].replace("left_front_light_top_outer", "ear")
    more = [*second[:3], ear, *second[3:]]
    call = ("fit", "-d", of_cars, "-o", "-", "-", "--live", "--method", "mean-shape")
    done = run_in(tmp_path, *call, text="".join([header, *first, *more]))
    assert done.returncode == 0
    assert "1 landmark left out, which the first item lacks (ear)" in done.stderr
    alone = run_in(tmp_path, *call, text="".join([header, *first, *second]))
    assert done.stdout == alone.stdout
    done = run_in(tmp_path, *call, text="".join([header, *first[1:], *second]))
    assert done.returncode == 2
    assert "the first item lacks the landmark 'left_front_light_top" in done.stderr
    assert "list all landmarks in the first item" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["views.csv", "-o", "-"], "reads standard input alone; give - as"),
        (["-", "-o", "r.h5"], "writes CSV to standard output alone; give -o -"),
        (["-", "-o", "parts/"], "writes CSV to standard output alone; give -o -"),
        (["-", "-o", "-"], "the method posterior cannot be live: its scales and"),
        (["-", "-o", "-", "--method", "sequences"], "it needs whole sequences; give"),
        (["-", "-o", "-", "--frames", "1:9"], "`--frames` is for files; leave out"),
        (["-", "-o", "-", "--every", "2"], "`--every` is for files; leave out"),
        (["-", "-o", "-", "--individual", "a"], "`--individual` is for files"),
    ],
)
def test_what_cannot_be_live_is_refused_with_the_fix(tmp_path, arguments, told):
    (tmp_path / "views.csv").write_text("item,landmark,x,y\n")
    done = run_in(tmp_path, "fit", "--live", *arguments, text="item,landmark,x,y\n")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("Error: --live: ")
    assert told in done.stderr


def test_a_header_alone_is_a_table_without_images(world, tmp_path):
    of_cars = world.dictionary("cars")
    call = ("fit", "-d", of_cars, "-o", "-", "-", "--live")
    done = run_in(tmp_path, *call, text="item,landmark,x,y\n")
    assert done.returncode == 1
    assert "holds no images" in done.stderr
    assert done.stdout == "item,landmark,x,y,z\n"
