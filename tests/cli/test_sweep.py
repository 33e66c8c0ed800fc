"""`shapefit sweep` from the command line."""

import csv


def options(project):
    people = project / "sample_data"
    return (
        "--set", f"learn_dict.shapes={people}/people_train.h5",
        "--set", "learn_dict.k=4", "--set", "learn_dict.iterations=1",
        "--set", "learn_dict.every=10",
        "--set", f"project.shapes={people}/people_test.h5",
        "--set", f"truth={people}/people_test.h5",
        "--set", "fit={}", "--set", "every=40", "--set", "vary={fit.lambda: [0.1, 0.5]}",
        "--set", "plots=false",
    )  # fmt: skip


def test_the_table_goes_to_stdout_and_the_rest_to_stderr(shapefit, folder, project):
    result = shapefit("sweep", "-o", "report", *options(project))
    assert result.code == 0, result.err
    assert result.out == (folder / "report/sweep.md").read_text("utf-8")
    assert result.err.splitlines()[-1].startswith("sweep: ")
    with (folder / "report/sweep.csv").open(newline="", encoding="utf-8") as file:
        assert [row["value"] for row in csv.DictReader(file)] == ["0.1", "0.5"]
