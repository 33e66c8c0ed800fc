"""Keys that several commands know are given in one way, and found where they are misspelt."""

import json

import pytest

from shapefit.config import CONFIGS, load_config
from shapefit.errors import InputError

OF_LANDMARKS = {"learn-dict", "fit", "convert", "info", "view"}
KEYS = {
    "frame_rate": (25.0, "framerate", {"learn-dict", "fit", "convert", "view"}),
    "keypoints": ("coco_17", "keypoint", OF_LANDMARKS),
    "individual": ("anna", "individuals", set(CONFIGS)),
    "image_size": ([640, 480], "imagesize", OF_LANDMARKS),
    "height": (1.7, "heigth", {"fit", "convert"}),
    "method": ("convex", "methods", {"learn-dict", "fit"}),
    "threads": (1, "thread", {"fit"}),
}


def load(command, key, value):
    return load_config(command, None, [f"{key}={json.dumps(value)}"], to_show=True, final=False)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("command", CONFIGS)
def test_a_short_key_is_the_same_in_every_command_that_knows_it(command, key):
    value, misspelt, commands = KEYS[key]
    value = "pca-bases" if (command, key) == ("learn-dict", "method") else value
    if command in commands:
        config = load(command, key, value).as_plain()
        sections = (config, config.get("input", {}), config.get("sequences", {}))
        assert value in [section.get(key) for section in sections]
    else:
        with pytest.raises(InputError, match=f"unknown key '{key}'"):
            load(command, key, value)
    with pytest.raises(InputError) as refused:
        load(command, misspelt, value)
    assert (f"did you mean '{key}'?" in str(refused.value)) == (command in commands)


@pytest.mark.parametrize(
    ("key", "found"),
    [
        ("max_iteration", "solver.max_iterations"),
        ("treshold", "outliers.threshold"),
        ("input.frame_rate", "frame_rate"),
        ("sequences.keypoints", "keypoints"),
    ],
)
def test_sections_are_searched(key, found):
    with pytest.raises(InputError, match=f"did you mean '{found}'"):
        load("fit", key, 1)
