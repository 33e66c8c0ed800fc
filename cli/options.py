"""Options that several commands have, and what makes a function a command.

An option that sets the key `a.b` of a config is the parameter `a__b`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps

import click

from shapefit.errors import InputError

from .call import Call
from .values import CONFIG, DICTIONARY, FILE, MATCH, SETTING, SIZE, SKELETON, TEXT, WORD

Callback = Callable[..., int]
Decorator = Callable[[Callback], Callback]


def combine_options(*options: Decorator) -> Decorator:
    """Return one decorator that adds these options, in the order of the help."""

    def decorate(function: Callback) -> Callback:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


def output(metavar: str, text: str) -> Decorator:
    """Return the decorator of the option -o; `text` is its help."""
    return click.option("-o", "--output", type=FILE, metavar=metavar, help=text)


def dictionary(text: str) -> Decorator:
    """Return the decorator of the option -d; `text` is its help."""
    return click.option(
        "-d", "--dictionary", type=DICTIONARY, metavar="DICT", help=text
    )


every = click.option("--every", type=int, metavar="N", help="Take every n-th frame.")

keypoints = click.option(
    "--keypoints",
    type=SKELETON,
    metavar="SKELETON",
    help="Skeleton of files without names: body_25 ...",
)

reading = combine_options(
    keypoints,
    click.option(
        "--individual", type=TEXT, metavar="NAME", help="Read only this individual."
    ),
    click.option(
        "--min-confidence",
        type=float,
        metavar="NUMBER",
        help="Hide less confident landmarks.",
    ),
)

frame_rate = click.option(
    "--frame-rate",
    type=float,
    metavar="HZ",
    help="Frames per second, if the files do not state it.",
)

metres = combine_options(
    frame_rate,
    click.option(
        "--image-size",
        type=SIZE,
        metavar="WxH",
        help="Size of the images in pixels, such as 1920x1080.",
    ),
    click.option(
        "--height",
        type=float,
        metavar="METRES",
        help="Height of the person in metres.",
    ),
    click.option(
        "--markers",
        type=WORD,
        metavar="WHICH",
        help="TRC markers: joints, or input (detector names).",
    ),
)

truth = combine_options(
    click.option(
        "--truth",
        type=FILE,
        multiple=True,
        metavar="SHAPES",
        help="File of the true 3D shapes. Repeatable.",
    ),
    click.option(
        "--match",
        type=MATCH,
        metavar="NAME",
        help="item, frame, or a dataset that names the true shape.",
    ),
)

of_config = combine_options(
    click.option(
        "-c",
        "--config",
        type=CONFIG,
        metavar="CONFIG",
        help="Config file (- is stdin), or an installed one.",
    ),
    click.option(
        "--set",
        "settings",
        type=SETTING,
        multiple=True,
        metavar="KEY=VALUE",
        help="Set any key of the config (`shapefit config` lists them). Repeatable.",
    ),
    click.option(
        "--print-config",
        is_flag=True,
        help="Print the config with every default as YAML, and exit.",
    ),
)


def json_option(text: str) -> Decorator:
    """Return the decorator of the option --json; `text` is its help."""
    return click.option("--json", "as_json", is_flag=True, help=text)


as_json = json_option("Print one JSON object to stdout.")

of_report = combine_options(
    json_option("Print one JSON object to stdout at the end."),
    click.option(
        "-q", "--quiet", is_flag=True, help="Print only errors and failed items."
    ),
    click.option(
        "-v",
        "--verbose",
        is_flag=True,
        help="Show all warnings, failed items and files.",
    ),
    click.option(
        "--traceback",
        is_flag=True,
        help="Show where an internal error arose (as SHAPEFIT_TRACEBACK=1 does).",
    ),
)

COMMON = (
    *("config", "settings", "print_config"),
    *("as_json", "quiet", "verbose", "traceback"),
)
"""Parameters of `of_config` and `of_report`, which go into the Call."""


def command(
    name: str, *examples: str, needs: Sequence[str] = ()
) -> Callable[[Callback], click.Command]:
    """Return the decorator that makes a function the command of this name.

    The function gets a Call, and its own parameters by name, among which are `needs`.
    Its docstring is the help, and `examples` stand at the end of that.
    """

    def decorate(function: Callback) -> click.Command:
        @wraps(function)
        def callback(**given: object) -> int:  # its docstring is that of `function`
            # problems are told in words of the command line
            common = {each: given.pop(each) for each in COMMON if each in given}
            call = Call(command=name, example=examples[0], needs=needs, **common)  # type: ignore[arg-type]
            call.check_needed_parameters(given)
            try:
                return function(call, **given)
            except InputError as error:
                raise InputError([*map(call.reword, error.problems)]) from error

        summary = " ".join(str(function.__doc__).partition("\n\n")[0].split())
        epilog = end_of_help(examples)
        return click.command(name, short_help=summary, epilog=epilog)(callback)

    return decorate


def end_of_help(examples: Sequence[str]) -> str:
    """Return the end of a command's help, which lists these examples."""
    return "\n  ".join(["\b\nExamples:", *examples])
