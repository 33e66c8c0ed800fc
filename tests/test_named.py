"""What is named is there: every path, command, option and key that pages, the Makefile,
the Dockerfile, configs and the strings of the source name.
"""

import ast
import inspect
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import click
import pytest
from shapefit.cli.main import commands

import shapefit
from shapefit.config import CONFIGS
from shapefit.config.reference import describe_keys

PROJECT = Path(__file__).resolve().parents[1]

PAGES = (
    "*.md",
    "docs/**/*",
    "sample_data/*.md",
    "configs/**/*.yaml",
    "Makefile",
    "Dockerfile",
    "benchmarks/notes/*.md",
)
PAST = "CHANGELOG.md"
"""It names what is gone."""
NOTES = "benchmarks/notes"
"""They name keys of their time, and files of today."""
ENDINGS = ("", ".md", ".yaml", ".py", ".sh")
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
QUOTED = re.compile(r"`([^`\n]+)`")


class Text(NamedTuple):
    """A text that people read, and where it stands: a page, or a string in the
    source.
    """

    place: str
    text: str

    @property
    def in_source(self) -> bool:
        """Whether it is a string of the package or of the command line."""
        return ".py:" in self.place


@cache
def texts() -> list[Text]:
    """Return all texts."""
    pages = [path for pattern in PAGES for path in sorted(PROJECT.glob(pattern))]
    found = [
        Text(path.relative_to(PROJECT).as_posix(), path.read_text(encoding="utf-8"))
        for path in pages
        if path.is_file() and path.suffix in ENDINGS and path.name != PAST
    ]
    for package in ("shapefit", "cli"):
        for path in sorted((PROJECT / package).rglob("*.py")):
            found += strings_of(path)
    return found


def strings_of(path: Path) -> Iterator[Text]:
    """Yield the strings of a module but its docstrings; X is what one fills in."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    outer = (ast.Expr, ast.JoinedStr)
    own = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, outer)
        for part in ast.iter_child_nodes(node)
    }
    for node in ast.walk(tree):
        if id(node) in own or not isinstance(node, ast.Constant | ast.JoinedStr):
            continue
        parts = node.values if isinstance(node, ast.JoinedStr) else [node]
        words = [p.value if isinstance(p, ast.Constant) else "X" for p in parts]
        place = f"{path.relative_to(PROJECT).as_posix()}:{node.lineno}"
        yield Text(place, "".join(map(str, words)))


# Paths

IN_THE_CLONE = re.compile(
    r"(?<![\w/.{}<>$-])(?:\.\./)*"
    r"((?:docs|configs|sample_data|shapefit|cli|tests|tools|benchmarks|experiments"
    r"|\.github)/[\w./*-]*[\w*])"
    r"(?![\w*$-])"
)


def absent_paths(text: Text) -> Iterator[str]:
    """Paths in the clone, or in the wheel, where configs are in the package."""
    for path in IN_THE_CLONE.findall(text.text):
        here = re.sub(r"^shapefit/(?=configs|cli)", "", path)
        if not any(PROJECT.glob(here)) and not path.endswith("/NAME"):
            yield path


RESULT = re.compile(r"(?<![\w/])(?:\.\./)*(results/[\w./-]*\w)(?!\w*\()")


def absent_results(text: Text) -> Iterator[str]:
    """Results that no config and no command of the Makefile writes; files in their
    folders have names that the source knows.
    """
    if not text.place.startswith(("README", "docs/", "Makefile", "Dockerfile")):
        return
    if text.place.startswith("docs/gallery/"):  # which write where they are told
        return
    for path in RESULT.findall(text.text):
        inside = any(path.startswith(f"{one}/") for one in written())
        is_known = inside and PurePosixPath(path).name in file_names()
        around = any(f"{one}/".startswith(f"{path}/") for one in written())
        if not (around or is_known or path.endswith("/NAME")):
            yield path


@cache
def written() -> frozenset[str]:
    """Return the outputs of configs, and those that commands of the Makefile name."""
    patterns = (
        r"-o\s+(results/\S+)",
        r"-m experiments .*?(results/\S+)",
        r"-m experiments\.people\.\w+ .*?(results/\S+)",
    )
    found = {path for each in patterns for path in re.findall(each, makefile())}
    for config in (PROJECT / "configs").rglob("*.yaml"):
        found |= {*RESULT.findall(config.read_text(encoding="utf-8"))}
    return frozenset(found)


@cache
def file_names() -> str:
    """Return the source that writes files, where their names stand."""
    modules = [*PROJECT.glob("experiments/*.py"), *PROJECT.glob("benchmarks/*.py")]
    sources = [path.read_text(encoding="utf-8") for path in modules]
    return "\n".join([*(t.text for t in texts() if t.in_source), *sources])


def makefile() -> str:
    return (PROJECT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")


# Commands


def absent_targets(text: Text) -> Iterator[str]:
    """Targets of make, and modules of this project that Python runs."""
    targets = {*re.findall(r"^([\w-]+):", makefile(), re.MULTILINE)}
    before = r"(?:`|^\$ |^#   |&& |\")"
    named = re.findall(rf"{before}make ([a-z][\w-]*)", text.text, re.MULTILINE)
    yield from (f"make {target}" for target in named if target not in targets)
    modules = r"python -m ((?:benchmarks|experiments|tests)[\w.]*)"
    for module in re.findall(modules, text.text):
        path = PROJECT / module.replace(".", "/")
        files = (path.with_suffix(".py"), path / "__main__.py")
        if not any(file.is_file() for file in files):
            yield f"python -m {module}"


def absent_commands(text: Text) -> Iterator[str]:
    """Commands with their options; in pages their values are checked, too."""
    for line in command_lines(text):
        try:
            words = shlex.split(line.partition(" | ")[0].partition(" > ")[0])
            parse(words[1:])
        except (click.NoSuchOption, KeyError) as error:
            yield f"{line}: {error}"
        except click.UsageError as error:
            fault = error.format_message()
            if text.place.endswith(".md") and "does not exist" not in fault:
                yield f"{line}: {fault}"  # the file is the reader's


def command_lines(text: Text) -> Iterator[str]:
    """Yield the commands of shapefit: those in quotes, in blocks of pages without a
    language, after a prompt, and of the Makefile.
    """
    whole = re.sub(r"\$\(SHAPEFIT\)", "shapefit", text.text.replace("\\\n", " "))
    whole = re.sub(r"\$\([^()]*\)", "", re.sub(r"\$\([^()]*\)", "", whole))
    at_start = r"^(?:\$ |# docker .* shapefit )?\s*(shapefit [a-z-].*(?:\n {4}.*)*)"
    blocks = [whole]
    if text.place.endswith(".md"):
        blocks = [
            block
            for _, language, block in FENCE.findall(whole)
            if language in ("", "console") and "Usage:" not in block
        ]
    if text.in_source:
        blocks = [part for part in blocks if part.startswith("shapefit ")]
    for block in blocks:
        for line in re.findall(at_start, block, re.MULTILINE):
            yield re.split(r"   #| \|\| ", line)[0]
    yield from re.findall(r"`(shapefit [a-z][^`\n]*)`", FENCE.sub("", whole))


def parse(words: Sequence[str]) -> None:
    """Parse a command. Raises KeyError without such a command, and click's errors."""
    command = commands.commands[words[0]]
    parent = commands.make_context("shapefit", [], resilient_parsing=True)
    given = ["fit" if word == "COMMAND" else word for word in words[1:]]
    given = [word for word in given if word != "..."]
    command.make_context(words[0], given, parent=parent)


# Options and keys

OTHERS = {
    *("--help", "--version"),
    # of this project's benchmarks
    *("--data", "--bodies", "--cells", "--clips", "--longest", "--floor", "--dropped"),
    *("--only", "--quick", "--trials"),
    # of pip, docker, dask
    *("--editable", "--rm", "--nthreads", "--nworkers"),
}
OPTION = re.compile(r"(?<![\w-])(--[a-z][a-z-]*[a-z])(?![\w-]*\.)")


def absent_options(text: Text) -> Iterator[str]:
    """Options of any command. Those of Makefile and Dockerfile are other programs'."""
    if text.place in ("Makefile", "Dockerfile") or text.place.startswith(NOTES):
        return
    known = {
        name
        for command in commands.commands.values()
        for parameter in command.params
        for name in parameter.opts
    }
    for option in OPTION.findall(text.text):
        if option not in known | OTHERS:
            yield option


KEYS = {row.name for model in CONFIGS.values() for row in describe_keys(model)} | {
    "data"
}
SECTIONS = {key.partition(".")[0] for key in KEYS if "." in key}
ASSIGNED = re.compile(r"^([a-z_]+(?:\.[a-z_]+)*)(?:=|: )(?=\S)")
DOTTED = re.compile(rf"^(?:{'|'.join(sorted(SECTIONS))})\.[a-z_]+$")


def absent_keys(text: Text) -> Iterator[str]:
    """Keys of any command, or arguments of Python: `a=value`, `a: value`, `section.a`,
    what is to be set, and what --set sets.
    """
    if text.place.startswith(NOTES):
        return
    named = []
    for quoted in QUOTED.findall(text.text):
        if assigned := ASSIGNED.match(quoted):
            named.append(assigned.group(1))
        elif DOTTED.match(quoted):
            named.append(quoted)
    named += re.findall(r"\b[Ss]et `([a-z_.]+)`", text.text)
    named += re.findall(r"--set '?([a-z_.]+)=", text.text)
    arguments = set() if text.in_source else python_arguments()
    known = KEYS | SECTIONS | arguments | {"key", "key.key"}
    yield from (key for key in named if key not in known)


@cache
def python_arguments() -> frozenset[str]:
    """Return the names of the arguments of the functions of `import shapefit`."""
    functions = [getattr(shapefit, name) for name in shapefit.__all__]
    return frozenset(
        name
        for function in functions
        if callable(function)
        for name in inspect.signature(function).parameters
    )


CHECKS: dict[str, Callable[[Text], Iterator[str]]] = {
    "path": absent_paths,
    "result": absent_results,
    "target": absent_targets,
    "command": absent_commands,
    "option": absent_options,
    "key": absent_keys,
}


@pytest.mark.parametrize("kind", CHECKS)
def test_what_is_named_is_there(kind):
    absent = [
        f"{text.place}: {name}" for text in texts() for name in CHECKS[kind](text)
    ]
    assert not absent, "\n".join(absent)


@pytest.mark.parametrize(
    ("kind", "place", "line", "name"),
    [
        ("path", "README.md", "see docs/nowhere.md", "docs/nowhere.md"),
        ("path", "cli/main.py:1", "(docs/form.md)", "docs/form.md"),
        ("path", "configs/a.yaml", "# ../configs/cart.yaml", "configs/cart.yaml"),
        ("result", "Makefile", "results/demo/report/view.html", "view.html"),
        ("result", "docs/cars.md", "`results/motorcycles`", "results/motorcycles"),
        ("target", "README.md", "Run `make tests`.", "make tests"),
        ("target", "docs/a.md", "`python -m benchmarks.foot`", "benchmarks.foot"),
        ("command", "a.py:1", "`shapefit lift a.csv`", "lift"),
        ("command", "a.py:1", "shapefit view X --truht X", "--truht"),
        ("command", "Makefile", "\t$(SHAPEFIT) fit -c a --sett b", "--sett"),
        ("command", "README.md", "```\nshapefit fit a.csv --every x\n```", "--every"),
        ("command", "docs/gallery/a.sh", "shapefit convert a --too ply", "--too"),
        ("option", "a.py:1", "(set --heigth)", "--heigth"),
        ("key", "a.py:1", "set `track: nearest` if", "track"),
        ("key", "README.md", "`camera.focus`", "camera.focus"),
        ("key", "README.md", "`prior.scales=2`", "prior.scales"),
        ("key", "a.py:1", "set `framerate`", "framerate"),
        ("key", "README.md", "$ shapefit fit --set lamda=2", "lamda"),
        ("key", "a.py:1", "`transforms=True`", "transforms"),
    ],
)
def test_what_is_absent_is_found(kind, place, line, name):
    (found,) = CHECKS[kind](Text(place, line))
    assert name in found
