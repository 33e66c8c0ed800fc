"""Messages of the command line name options, those of files and of Python keys."""

import pytest
from shapefit.cli.main import commands
from shapefit.cli.wording import name_options, options_of_keys

from shapefit.config import CONFIGS
from shapefit.config.model import list_config_keys


@pytest.mark.parametrize(
    ("key", "option"),
    [
        ("set `frame_rate`", "set `--frame-rate`"),
        ("`frame_rate: 30`", "`--frame-rate 30`"),
        ("`camera.focal=none` does without", "`--focal none` does without"),
        ("needs `focal`", "needs `--focal`"),
        ("`image_size=[1920,1080]`", "`--image-size 1920x1080`"),
        ("set `y_axis: up`", "set `--set y_axis=up`"),
        ("`rename={a: b}`", "`--set 'rename={a: b}'`"),
        ("run `shapefit info`, with `leave_one_out`", None),
        ("lambda: expected a number", "--lambda: expected a number"),
        ("fit.yaml:3:1: expected a number", None),
        ("landmarks: no file a.csv", None),
    ],
)
def test_a_key_becomes_an_option(key, option):
    keys = {".".join(path) for path in list_config_keys(CONFIGS["fit"])}
    options = options_of_keys(commands.commands["fit"])
    assert name_options(key, options, keys) == (option or key)
