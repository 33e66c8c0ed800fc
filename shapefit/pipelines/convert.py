"""`convert`: landmarks, shapes or results in, the same in another format out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from shapefit.config import ConvertConfig
from shapefit.errors import input_error
from shapefit.io import (
    LandmarkSet,
    LandmarkSource,
    ResultSet,
    ShapeSet,
    ShapeSource,
    open_landmarks,
    open_shapes,
)
from shapefit.io.duplicates import ItemList, check_unique_items
from shapefit.io.formats import find_target_format
from shapefit.io.kinds.kind import Kind, find_kind
from shapefit.io.kinds.results import read_results
from shapefit.io.layout import LANDMARKS, RESULTS, SHAPES
from shapefit.io.options import InputOptions, OutputOptions
from shapefit.io.records import concatenate
from shapefit.io.sources import is_stream
from shapefit.io.writing import record_writer
from shapefit.pipelines.outcome import Outcome, nothing_in
from shapefit.pipelines.reading import input_options

FORMS = {"landmarks": LANDMARKS, "shapes": SHAPES, "result": RESULTS}

Records = LandmarkSet | ShapeSet | ResultSet


def run(config: ConvertConfig) -> Iterator[Outcome]:
    """Read the files and write them; yields an Outcome per chunk."""
    target = find_target_format(config.output, config.to)
    options = input_options(config.input, "nearest" if target.by_sequence else "none")
    kind = find_common_kind(config.files, options)
    if kind == "dictionary":
        found = "is a dictionary, which has no other format"
        raise input_error(config.files[0], found, "give landmarks, shapes or results")
    sized = OutputOptions(
        height=config.height, unit=config.unit, up=config.up, world_unit=config.world_unit
    )
    with record_writer(config.output, FORMS[kind], config.to, sized) as writer:
        if kind == "result":
            yield from _results(config, writer)
        else:
            opened: LandmarkSource | ShapeSource = (
                open_landmarks(config.files, options)
                if kind == "landmarks"
                else open_shapes(config.files, options, gaps=True)
            )
            with opened as source:
                for chunk in source.chunks(config.chunk):
                    writer.append(_with_rate(chunk, config))
                    yield Outcome(done=len(chunk), total=source.count, unit=_unit(kind))
                warnings = source.notes + nothing_in(source.count, _unit(kind) + "s")
                yield Outcome(total=source.count, warnings=warnings)
    said = writer.summary
    yield Outcome(warnings=said.warnings, note=said.note, written=said.written or (config.output,))


def find_common_kind(files: Sequence[Path], options: InputOptions) -> Kind:
    """Return what the files hold. Raises InputError where they hold different things."""
    if any(map(is_stream, files)):
        return "landmarks"
    kinds = {path: find_kind(path, options) for path in files}
    first = kinds[files[0]]
    for path, kind in kinds.items():
        if kind != first:
            found = f"holds {_named(kind)}, and {files[0]} holds {_named(first)}"
            raise input_error(path, found, "convert them one after the other")
    return first


def _results(config: ConvertConfig, writer: Any) -> Iterator[Outcome]:
    """Write results whole, with what proves them."""
    results = [read_results(path, proofs=True) for path in config.files]
    names = [str(path) for path in config.files]
    check_unique_items(
        [
            ItemList(lambda own=own: [own.items], lambda _, name=name: name)  # type: ignore[misc]
            for own, name in zip(results, names, strict=True)
        ]
    )
    result = results[0] if len(results) == 1 else concatenate(results)
    writer.append(_with_rate(result, config))
    writer.attributes.update(result.attributes)
    yield Outcome(done=len(result), total=len(result), unit="image")


def _with_rate(records: Any, config: ConvertConfig) -> Any:
    """Return the records with the frame rate of the config, where it gives one."""
    rate = config.frame_rate
    return records if rate is None else replace(records, frame_rate=rate)


def _unit(kind: Kind) -> str:
    return "shape" if kind == "shapes" else "image"


def _named(kind: Kind) -> str:
    return {"result": "a result", "dictionary": "a dictionary"}.get(kind, kind)
