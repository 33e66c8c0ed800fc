"""`eval` says so where the truth is the training data of the dictionary."""

import pytest

from shapefit.config import EvalConfig
from shapefit.pipelines.evaluate.run import run
from tests.pipelines.told import texts


@pytest.mark.parametrize("kind", ["seen", "unseen"])
def test_truth_that_the_dictionary_was_learned_from_is_a_warning(world, tmp_path, kind):
    truth = world.shapes("people") if kind == "seen" else world.truth("people")
    config = EvalConfig(
        results=[world.fit("people", images=world.views("people", shapes=[str(truth)]))],
        truth=[truth],
        output=tmp_path / "report",
        plots=False,
        view=False,
    )
    said = [text for text in texts(run(config)) if "learned from the truth" in text]
    page = (tmp_path / "report/report.md").read_text(encoding="utf-8")
    if kind == "seen":
        assert f"the dictionary was learned from the truth, {truth}" in said[0]
        assert "learned from the truth" in page
    else:
        assert not said
        assert "learned from the truth" not in page
