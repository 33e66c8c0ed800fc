"""The page of all config keys, written from the schema."""

from __future__ import annotations

import json
from collections.abc import Iterator

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from shapefit.config.fields import expectation, field_keys, in_words, submodel
from shapefit.config.loader import CONFIGS
from shapefit.config.paths import OfTheData
from shapefit.stores.options import STORAGE_OPTIONS

_INTRODUCTION = """\
# Config keys

Each command reads one YAML file (`-c`), in YAML 1.2: `1e-3` is a number and `no` is a string. \
`--set key=value` and `--set key.key=value` override the file; arguments override both.

- Paths in a file are relative to the file, paths on the command line to the working directory.
- A path to read may be a glob (`*`, `?`, `[...]`, `**`); it must match at least one file.
- `-` is standard input or output, as CSV.
- A path may begin with `{data}`: it is replaced by the folder that the key `data` names. Every
  command has this key.
- A path may be a URL of an object store, `s3://BUCKET/NAME` or `gs://BUCKET/NAME` \
([scale.md](scale.md#object-stores)).
  Credentials come from the environment; `storage_options`, a key of every command, maps further
  options of fsspec to their values, which are shown as `***` wherever a config is printed or
  stored.
- `-c NAME` stands for the command's own file of an installed folder: `-c cars` of `fit` is
  `configs/cars/fit.yaml`, and `-c sequences` is `configs/people/sequences.yaml`. An existing file
  of that name is preferred. The settings of an installed file are used; what applies only to its
  own data is ignored: paths, and the keys marked with \\*.
- `-d NAME`, or `dictionary: NAME` in a file, stands for an installed dictionary, such as `people`.
  An existing file of that name is preferred.
- `--print-config` prints the resolved config, with every default.
"""


def reference_page() -> str:
    """Return the page of all keys of all commands, as Markdown."""
    sections = [_section(command, model) for command, model in CONFIGS.items()]
    return "\n".join([_INTRODUCTION, *sections])


def _section(command: str, model: type[BaseModel]) -> str:
    rows = "\n".join(_rows(model))
    return (
        f"## `{command}`\n\n{model.__doc__}\n\n"
        f"| key | expects | default | meaning |\n|---|---|---|---|\n{rows}\n"
    )


def _rows(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for key, field in field_keys(model).items():
        if key in ("data", STORAGE_OPTIONS):
            continue
        inner = submodel(field)
        if inner is None or in_words(field):
            mark = r" \*" if any(isinstance(entry, OfTheData) for entry in field.metadata) else ""
            name = f"`{prefix}{key}`{mark}"
            cells = (name, expectation(field), _default(field), field.description)
            yield f"| {' | '.join(str(cell) for cell in cells)} |"
        else:
            yield from _rows(inner, f"{prefix}{key}.")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    return "none" if default is None else f"`{json.dumps(default)}`"
