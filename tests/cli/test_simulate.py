"""`shapefit simulate` from the command line."""

SMALL = ("--set", "landmarks=[10]", "--set", "active_atoms=[1]", "--set", "trials=2")


def test_the_table_goes_to_stdout_and_the_rest_to_stderr(shapefit, folder):
    result = shapefit("simulate", "-o", "report", *SMALL, "--set", "plots=false")
    assert result.code == 0
    assert result.out == (folder / "report/recovery.md").read_text("utf-8")
    assert result.err.startswith("simulate: 2 trials in ")


def test_trials_that_were_not_solved_give_exit_code_1(shapefit):
    limit = ("--set", "solver.max_iterations=1", "--set", "plots=false")
    result = shapefit("simulate", "-o", "report", *SMALL, *limit)
    assert result.code == 1
    assert "Failed: p=10 z=1 trial 0: iteration limit after 1 iteration, " in result.err
    assert "2 failed" in result.err
