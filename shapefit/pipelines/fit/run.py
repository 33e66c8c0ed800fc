"""`fit`: landmarks in, batch by batch, 3D shapes with their certificates out, and a
summary.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.arrays import Flags, Floats, median
from shapefit.config import FitConfig
from shapefit.convex.solver import Status
from shapefit.core import IMAGES_PER_BLOCK
from shapefit.dictionary.bodies import has_lengths, knows_size, metres_per_unit
from shapefit.dictionary.model import Dictionary
from shapefit.errors import abbreviate, as_typed, counted, input_error
from shapefit.io import (
    LandmarkSet,
    LandmarkSource,
    ResultSet,
    digests,
    open_landmarks,
    read_dictionary,
)
from shapefit.io.formats import HDF5, find_target_format, result_writer
from shapefit.io.inputs import State, check_unchanged, find_state
from shapefit.io.layout import (
    FRAME,
    INPUT_ROWS,
    LANDMARKS,
    METRES_FROM,
    METRES_PER_UNIT,
    RESULTS,
    STATED_HEIGHT,
    TIME,
    free_names,
)
from shapefit.io.options import OutputOptions, Summary
from shapefit.io.skeletons import joint_columns
from shapefit.io.writers.metres import with_stated_height
from shapefit.lifting import trust
from shapefit.lifting.lift import Lifting, fail_nonfinite
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit import prepare as preparing
from shapefit.pipelines.fit.lift import (
    find_omitted,
    lift_images,
    lift_omitting,
    weigh,
    with_p_values,
)
from shapefit.pipelines.fit.prepare import (
    FEWEST,
    FIRST,
    MOSTLY,
    OUTLIER,
    Estimates,
    Setup,
    prepare,
    warn_of_dictionary,
)
from shapefit.pipelines.joints import is_of_people
from shapefit.pipelines.result import Counted, Failure, Result, nothing_in
from shapefit.threads import side_by_side

CHUNK = 4096
"""Images that are lifted together, or read before the first whole sequences are lifted;
no result depends on it.
"""

STEEP = 0.5
"""Cosine of the angle to the vertical of the image within which a body is on its head.
"""

ENDS = (
    ("head", "neck", "lshoulder", "rshoulder"),
    ("lankle", "rankle", "lhip", "rhip"),
)
"""Joints at the upper and the lower end of a body: the first two that it has."""

VIEWED = (".h5", ".hdf5", ".hdf", ".he5", ".csv", ".trc")
"""Endings of results that `shapefit view` shows."""

MOST_VIEWED = 4
"""Files of a fit that the command to go on with names one by one."""


Datasets = Mapping[str, NDArray[Any] | None]
Lifted = tuple[Result, ResultSet]


def run(
    config: FitConfig,
    rows: slice | None = None,
    estimates: Estimates | None = None,
    dictionary: Dictionary | None = None,
    inputs: Mapping[str, str] | None = None,
    states: Mapping[Path, State] | None = None,
) -> Iterator[Result]:
    """Lift every image, or these rows of the one file; of a part, what is known of all
    is given.

    `inputs` are digests of the landmarks, `states` those of all files when they were
    found. Raises InputError, and writes nothing, where one of them changes meanwhile.
    """
    output = config.output
    assert isinstance(output, Path), "a folder is written part by part"
    if states is None:
        read = (*config.landmarks, *preparing.files_of(config).values())
        states = {path: find_state(path) for path in read}
    dictionary = dictionary or read_dictionary(config.dictionary)
    config, method = preparing.choose_method(
        config, dictionary, lambda: preparing.in_sequences(config)
    )
    if find_target_format(output).angles:
        config = config.changed(
            save={"covariance": True}
        )  # an angle is that of several joints
    with open_landmarks(
        config.landmarks, preparing.read_options(config), rows
    ) as source:
        names, count = source.head.landmark_names, source.count
        setup = yield from prepare(
            config, dictionary, names, lambda: source.first(FIRST), count, estimates
        )
        check_export(setup, output)
        options = OutputOptions(height=config.height, markers=config.markers)
        if find_target_format(output) is HDF5:
            options = options._replace(height=None)  # which each image states
        counts = Counts()
        with (
            result_writer(output, options=options) as writer,
            closing(lift_source(source, setup)) as batches,
        ):
            for result, record in batches:
                if inputs is None:  # while the next batch is lifted
                    inputs = digests(config.landmarks)
                counts.add(record)
                yield result._replace(total=count)
                writer.append(record)
            others = digests(preparing.files_of(setup.config).values())
            writer.attributes.update(attributes_of(setup, {**(inputs or {}), **others}))
            check_unchanged(states)
            writer.seal = {}
            if rows is not None:
                writer.seal[INPUT_ROWS] = f"{rows.start}:{rows.stop}"
    yield summary_of(source, setup, counts, method, writer.summary)
    if config.export.folder is not None:
        yield from export_meshes(config, output, config.export.folder)


def check_export(setup: Setup, result: Path) -> None:
    """Raise InputError where a result will have no meshes, if the config asks for
    them.
    """
    export, method = setup.config.export, setup.lifter.row
    if export.folder is not None:
        from shapefit.io.atomic import check_folder
        from shapefit.pipelines.meshes import check_has_meshes

        if find_target_format(result) is not HDF5:
            fix = "write the result as HDF5, -o result.h5"
            raise input_error(
                "export.folder", "meshes are made of a result in HDF5", fix
            )
        check_folder(export.folder)
        refined = setup.lifter.camera is not None and method.perspective == "refined"
        mixes, place = method.mixes_atoms or refined, setup.config.dictionary
        check_has_meshes(setup.dictionary, place, mixes_atoms=mixes)


def lift_source(source: LandmarkSource, setup: Setup) -> Generator[Lifted, None, None]:
    """Lift batch by batch; while one is lifted, the next is read and the last is
    stored.
    """
    batches = source.batches(whole_blocks(CHUNK), by_file=True)
    if setup.lifter.row.sequences:
        from shapefit.pipelines.fit.sequences import whole_sequences

        batches = whole_sequences(source.batches(CHUNK))
    several = setup.config.threads != 1 and source.count > CHUNK
    images = map(setup.arrange, batches)
    return side_by_side(
        lambda batch: lift_batch(batch, setup), images, workers=int(several)
    )


def whole_blocks(images: int) -> int:
    """Round up to whole blocks: within one, images start from their neighbours'
    solutions.
    """
    return math.ceil(images / IMAGES_PER_BLOCK) * IMAGES_PER_BLOCK


def lift_batch(images: LandmarkSet, setup: Setup) -> Lifted:
    """Lift images that have the landmarks of the dictionary; return the result and the
    record.
    """
    lifter, lifted, further = setup.lifter, images, {}
    if lifter.row.sequences:
        from shapefit.pipelines.fit.sequences import refine_sequences, restore_sides

        lifted, further[trust.SIDES] = restore_sides(
            images, weigh(images, lifter) > 0, lifter
        )
    omits = lifter.leave_one_out is not None
    lifting = lift_omitting(lifted, lifter) if omits else lift_images(lifted, lifter)
    if lifter.row.has_prior:
        lifting = with_p_values(lifting, lifter)
    if lifter.row.sequences:
        lifting = refine_sequences(lifting, lifted, lifter)
    lifting = fail_nonfinite(lifting)
    estimate = replace(
        lifting.estimate, further={**lifting.estimate.further, **further}
    )
    if setup.dictionary.depth_ambiguity:
        estimate = trust.cover_mirror_image(estimate)
    visible, lifting = weigh(lifted, lifter) > 0, replace(lifting, estimate=estimate)
    lifting, input_shapes = setup.matched.to_joints(
        lifting, setup.theta, lifted.landmarks, visible, lifter.variance
    )
    record = as_result(images, lifting, setup, input_shapes)
    return result_of(lifting, record), record


def as_result(
    images: LandmarkSet,
    lifting: Lifting,
    setup: Setup,
    inputs: Mapping[str, NDArray[Any]],
) -> ResultSet:
    """Lay out a batch as it is stored, with what came with its landmarks.

    inputs are the landmarks of the files in 3D, where they are not those of the
    dictionary.
    """
    estimate, dictionary, config = lifting.estimate, setup.dictionary, setup.config
    stored = estimate if config.save.covariance else replace(estimate, covariance=None)
    scaled, failed = (
        stored.in_unit(lifting.scale[:, None, None]),
        np.isnan(lifting.scale),
    )
    projected = lifting.perspective is not None or setup.matched.moves
    datasets: Datasets = {
        "landmarks": (
            np.where(images.visible()[:, None], images.landmarks, np.nan).swapaxes(1, 2)
        ),
        "landmarks_fitted": lifting.landmarks_fitted if projected else None,
        "confidence": images.confidence,
        FRAME: images.frame,
        TIME: images.time,
        "lambda": lifting.problem.lam,
        "coefficients": blank(estimate.coefficients, failed),
        "rotation": blank(estimate.rotation, failed),
        "objective": blank(estimate.objective, failed),
        "relative_gap": blank(estimate.relative_gap, failed),
        "residual": estimate.residual,
        "active_atoms": estimate.active_atoms,
        "tight": estimate.tight,
        "outliers": estimate.outliers,
        METRES_PER_UNIT: metres_per_unit(lifting.shapes, dictionary),
        STATED_HEIGHT: (
            None if config.height is None else np.full(len(images), config.height)
        ),
        **estimate.further,
        **trusted(lifting, setup),
        **of_camera(lifting, setup),
        **(proof(lifting, config.method, failed) if config.save.proof else {}),
        "shape_covariance": by_landmark(scaled.covariance),
    }
    columns = {name: values for name, values in datasets.items() if values is not None}
    if config.leave_one_out is not None:
        columns["omitted"] = find_omitted(images, setup.lifter).astype(object)
    others = [name for name in images.further if name not in LANDMARKS.further]
    free = free_names(others, RESULTS.all.keys())
    carried = {free[name]: v for name, v in images.per_item.items() if name in free}
    whole = {
        free[name]: values for name, values in images.whole.items() if name in free
    }
    whole |= {} if dictionary.edges is None else {"edges": dictionary.edges}
    sizes = {METRES_FROM: "edges" if has_lengths(dictionary) else "spread"}
    return ResultSet(
        shapes=lifting.shapes,
        shape_sd=scaled.deviation,
        translation=lifting.translation,
        scale=lifting.scale,
        iterations=estimate.iterations,
        status=estimate.status_words(),
        landmark_names=images.landmark_names,
        items=images.items,
        sequences=images.sequences,
        unit=images.unit,
        y_axis=images.y_axis,
        frame_rate=config.frame_rate or images.frame_rate,
        attributes=sizes if knows_size(dictionary) else {},
        columns={**carried, **columns, **inputs},
        whole=whole,
    )


def blank(values: Floats | None, failed: Flags) -> Floats | None:
    """Return values (n, ...) that are nan where an image has no shape: failed (n,)."""
    if values is None or not failed.any():
        return values
    return np.where(failed.reshape(-1, *(1,) * (values.ndim - 1)), np.nan, values)


def trusted(lifting: Lifting, setup: Setup) -> Datasets:
    """Decide which shapes are to be trusted, by error bars in the unit of the
    result.
    """
    estimate = lifting.estimate
    if estimate.deviation is None:
        return {}
    further, expected = estimate.further, np.full(len(lifting.shapes), np.nan)
    shown = setup.lifter.shown
    if estimate.covariance is not None:
        expected = trust.expected_error(lifting.shapes, estimate.covariance, shown)
        expected *= lifting.scale
        of_image = further.get(trust.IMAGE_ERROR, np.nan)
        expected = np.fmax(expected, trust.SEQUENCE_ERROR_SHARE * of_image)
    reasons = trust.find_reasons(
        lifting.shapes,
        expected,
        np.isfinite(further["inlier_probability"]).sum(axis=1),
        further[trust.P_VALUE],
        further[trust.START_DISTANCE],
        estimate.status,
        sides=further.get(trust.SIDES),
        depth_ambiguity=setup.dictionary.depth_ambiguity,
        shown=shown,
    )
    reasons[reasons == ""] = setup.estimates.reason
    names = (trust.TRUSTED, trust.REASONS, trust.EXPECTED_ERROR)
    return dict(zip(names, (reasons == "", reasons, expected), strict=True))


def by_landmark(covariance: Floats | None) -> Floats | None:
    """Return a covariance (n, 3p, 3p) with x, y, z of one landmark after the other."""
    if covariance is None:
        return None
    n, d, _ = covariance.shape
    blocks = covariance.reshape(n, 3, d // 3, 3, d // 3).transpose(0, 2, 1, 4, 3)
    return blocks.reshape(n, d, d)


def of_camera(lifting: Lifting, setup: Setup) -> Datasets:
    """Lay out a perspective view; the position is in the unit of a dictionary that has
    sizes.
    """
    view, dictionary, position = lifting.perspective, setup.dictionary, None
    if view is None:
        return {}
    coefficients = lifting.estimate.coefficients
    if dictionary.atom_scale is not None and coefficients is not None:
        from shapefit.meshes.dense import metric_scale

        unit = metric_scale(dictionary.atoms, coefficients, dictionary.atom_scale)
        position = unit[:, None] * view.translation
    return {
        "camera_translation": view.translation,
        "focal": view.camera.focal,
        "principal_point": view.camera.centre,
        "position": position,
    }


def proof(lifting: Lifting, method: str, failed: Flags) -> Datasets:
    """Lay out what proves the optimum of the convex program; images that failed (n,)
    have nan.
    """
    certificate = lifting.estimate.convex_proof
    if certificate is None:
        return {}
    M = certificate.transforms
    if failed.any():
        retained, count = ~failed[M.image], np.where(failed, 0, M.count)
        M = replace(M, count=count, atom=M.atom[retained], blocks=M.blocks[retained])
    datasets = {
        "dual": blank(certificate.dual, failed),
        "convex_translation": blank(certificate.translation, failed),
        "transform_count": M.count,
        "transform_atom": M.atom,
        "active_transforms": M.blocks,
    }
    if METHODS[method].proves != "optimum" or lifting.perspective is not None:
        datasets["convex_objective"] = blank(certificate.objective, failed)
        datasets["convex_relative_gap"] = blank(certificate.relative_gap, failed)
    return datasets


def attributes_of(
    setup: Setup, inputs: Mapping[str, str]
) -> dict[str, str | float | int]:
    """Return what is stored of a fit beside its images; `inputs` are the digests of its
    files.
    """
    config, numbers = setup.config.as_json(), setup.estimates.numbers
    return {
        "method": setup.config.method,
        "version": __version__,
        "config": config,
        "config_digest": hashlib.sha256(config.encode()).hexdigest(),
        "inputs": json.dumps(inputs),
        "estimated": "; ".join(setup.estimates.lines),
        **{name: value for name, value in numbers.items() if value == value},
        **shown_landmarks(setup),
        "training_inputs": setup.dictionary.provenance.get("inputs", "{}"),
    }


def shown_landmarks(setup: Setup) -> dict[str, str]:
    """Return the names of the landmarks whose errors are expected ones, where known."""
    names = setup.dictionary.landmark_names
    shown = [
        name for name, seen in zip(names, setup.estimates.shown, strict=False) if seen
    ]
    return {"shown_landmarks": " ".join(shown)} if shown else {}


def result_of(lifting: Lifting, record: ResultSet) -> Result:
    """Return the result of a batch: failures, and whom not to trust."""
    items, by_reason = record.items, dict[str, list[str]]()
    for item, reason in zip(items, record.columns.get(trust.REASONS, ()), strict=False):
        if reason not in ("", trust.NO_SHAPE):  # which has failed
            by_reason.setdefault(reason, []).append(item)
    limited = lifting.estimate.status.count(Status.ITERATION_LIMIT)
    empty = ~lifting.estimate.shapes.any(axis=(1, 2)) & np.isfinite(lifting.scale)
    empty[list(lifting.failures)] = False
    text = (
        "with an empty shape: lambda is at or above lambda_max of the image; lower"
        " `lambda`"
    )
    warnings = (
        Counted(limited, "image", "not optimal"),
        Counted(int(empty.sum()), "image", text),
    )
    return Result(
        done=len(items),
        failures=tuple(
            Failure(items[row], why) for row, why in sorted(lifting.failures.items())
        ),
        warnings=tuple(warning for warning in warnings if warning.number),
        reasons=tuple(
            Counted(len(of), "image", why, tuple(of)) for why, of in by_reason.items()
        ),
    )


@dataclass
class Counts:
    """What adds up over the batches of a fit, for its end.

    errors are those expected, in metres; outliers and visible (p,) count images.
    solved images have a gap; largest_gap is that of them all.
    """

    images: int = 0
    sequences: set[str] = field(default_factory=set)
    evaluated: int = 0
    trusted: int = 0
    errors: list[float] = field(default_factory=list)
    outliers: Any = 0
    visible: Any = 0
    bodies: int = 0
    on_head: int = 0
    solved: int = 0
    optimal: int = 0
    largest_gap: float | None = None

    def add(self, record: ResultSet) -> None:
        """Count a batch."""
        columns, names = record.columns, record.landmark_names
        self.images += len(record)
        self.sequences.update(record.sequences or ())
        if trust.TRUSTED in columns:
            trusted = columns[trust.TRUSTED].astype(bool)
            self.evaluated += len(record)
            self.trusted += int(trusted.sum())
            sized = with_stated_height(record, "fit").columns
            errors = columns[trust.EXPECTED_ERROR] * sized.get(METRES_PER_UNIT, np.nan)
            self.errors += errors[trusted & np.isfinite(errors)].tolist()
            probability = columns["inlier_probability"]
            self.outliers = self.outliers + (probability < OUTLIER).sum(axis=0)
            self.visible = self.visible + np.isfinite(probability).sum(axis=0)
        if record.relative_gap is not None:
            gaps = record.relative_gap[np.isfinite(record.relative_gap)]
            self.solved += len(gaps)
            if record.status is not None:
                self.optimal += int((record.status == Status.OPTIMAL.value).sum())
            if len(gaps):
                self.largest_gap = max(self.largest_gap or 0.0, float(gaps.max()))
        joints = joint_columns(names) if is_of_people(names) else {}
        ends = [[joints[joint] for joint in end if joint in joints][:2] for end in ENDS]
        if all(ends):
            top, bottom = (record.shapes[:, :, end].mean(axis=2) for end in ends)
            body = (top - bottom)[np.isfinite(top - bottom).all(axis=1)]
            down = body[:, 1] * (-1 if record.y_axis == "up" else 1)
            self.bodies += len(body)
            self.on_head += int((down > STEEP * np.linalg.norm(body, axis=1)).sum())


def summary_of(
    source: LandmarkSource, setup: Setup, counts: Counts, method: str, writer: Summary
) -> Result:
    """Return the end of a fit: warnings about all images, a note, and the rows of the
    summary.
    """
    head, estimates = source.head, setup.estimates
    warnings = [*estimates.warnings, *nothing_in(source.count, "images"), *source.notes]
    warnings += [
        *setup.matched.warnings(),
        *warn_of_dictionary(setup.config, setup.dictionary),
    ]
    return Result(
        total=source.count,
        warnings=(*warnings, *warn_of_all(counts, setup, head), *writer.warnings),
        note="; ".join([f"y {head.y_axis} in the images", *estimates.lines]),
        rows=tuple(rows_of(source, setup, counts, method, writer)),
        data=partial(numbers_of, setup, counts),
        written=writer.written or (Path(str(setup.config.output)),),
    )


def warn_of_all(
    counts: Counts, setup: Setup, head: LandmarkSet
) -> Iterator[str | Counted]:
    """Yield what is known at the end only, by shares of all images; head, as the files
    state it.
    """
    if 2 * counts.on_head > counts.bodies:
        other = "up" if head.y_axis == "down" else "down"
        text = (
            f"with people on their heads: y was taken to point {head.y_axis}: if it"
            " points "
        )
        text += (
            f"{other}, set `y_axis: {other}`; or is the video turned by 180 degrees?"
        )
        yield Counted(counts.on_head, "image", text)
    markers, names = setup.matched.joints.markers, setup.dictionary.landmark_names
    for j in np.flatnonzero(
        counts.outliers > MOSTLY * np.maximum(counts.visible, FEWEST)
    ):
        name = " and ".join(markers.get(names[j], (names[j],)))
        text = (
            f"in which {name} contradicts the model: rename it if it is another point"
            " of the "
        )
        text += f"body, or leave it out with `rename={{{name}: unused}}`"
        yield Counted(int(counts.outliers[j]), "image", text)
    if setup.lifter.row.sequences and not (setup.config.frame_rate or head.frame_rate):
        yield (
            "the frame rate is unknown, so the motion from image to image is taken for"
            " that of the training shapes; set `frame_rate`"
        )


def rows_of(
    source: LandmarkSource,
    setup: Setup,
    counts: Counts,
    method: str,
    written: Summary,
) -> Iterator[tuple[str, str]]:
    """Yield the rows of the summary, label and text."""
    config, output = setup.config, Path(str(setup.config.output))
    images = counted(counts.images, "image")
    read = (
        f"{abbreviate([path.name or str(path) for path in config.landmarks], 1)}:"
        f" {images}"
    )
    read += (
        f" of {counted(len(counts.sequences), 'sequence')}" if counts.sequences else ""
    )
    if matched := sum(map(len, setup.matched.joints.markers.values())):
        read += f"; matched {matched} of {len(source.head.landmark_names)} keypoints"
    yield "Read", read
    yield "Method", method or config.method
    yield "Camera", setup.estimates.lines[0].removeprefix("camera: ")
    if written.note:
        yield "Metres", written.note
    result = f"{images}{gap_of(setup, counts)} (no error bars by this method)"
    if counts.evaluated:
        size = (
            f"{100 * median(np.array(counts.errors)):.0f} cm" if counts.errors else ""
        )
        about = f", expected error about {size}{of_shown(setup)}" if size else ""
        result = f"{counts.trusted} of {images} trusted{about}"
    elif setup.dictionary.prior is None:
        bars = "no error bars: `learn-dict --prior` learns what they need"
        result = f"{images}{gap_of(setup, counts)} ({bars})"
    yield "Result", "; ".join(filter(None, [result, written.angles]))
    if files := viewed(written.written or (output,), output):
        yield "Next", f"shapefit view {' '.join(map(as_typed, files))}"


def viewed(written: Sequence[Path], output: Path) -> Sequence[Path]:
    """Return which of the files that an output became `shapefit view` shows, as a glob
    where there are many.
    """
    files = [
        path
        for path in written
        if path.suffix.lower() in VIEWED
        and not path.name.lower().endswith(("_angles.csv", ".angles.csv"))
    ]
    if len(files) <= MOST_VIEWED:
        return files
    ending = ".metres.csv" if output.match("*.metres.csv") else output.suffix
    return [output.with_name(f"{output.name.removesuffix(ending)}_*{ending}")]


def gap_of(setup: Setup, counts: Counts) -> str:
    """Return how far images may be from the optimum, as the line of the result goes on;
    "" for methods that do not say.
    """
    if counts.largest_gap is None:
        return ""
    if setup.lifter.row.proves == "bound":
        return f", within {counts.largest_gap:.1e} of the convex bound"
    missed = counts.solved - counts.optimal
    solved = f"{missed:,} not optimal" if missed else "all optimal"
    return f", {solved}, largest gap {counts.largest_gap:.1e}"


def numbers_of(setup: Setup, counts: Counts) -> dict[str, int | float | None]:
    """Return what the line of the result says, as numbers; None for what the method
    does not say. The error is the median of those expected of trusted images.
    """
    certifies = setup.lifter.row.proves in ("optimum", "global")
    has_gaps = certifies and counts.largest_gap is not None
    return {
        "images": counts.images,
        "trusted": counts.trusted if counts.evaluated else None,
        "expected_error_metres": (
            float(median(np.array(counts.errors))) if counts.errors else None
        ),
        "optimal": counts.optimal if has_gaps else None,
        "not_optimal": counts.solved - counts.optimal if has_gaps else None,
        "largest_gap": counts.largest_gap,
    }


def of_shown(setup: Setup) -> str:
    """Return of how many landmarks the expected error is, "" where it is of all."""
    shown = setup.estimates.shown
    own = setup.dictionary.depends_on < 0
    if not shown or sum(shown) == own.sum():
        return ""
    return f" of the {sum(shown)} landmarks that are seen"


def export_meshes(config: FitConfig, result: Path, folder: Path) -> Iterator[Result]:
    """Write the meshes of a result, as `convert` does."""
    from shapefit.pipelines.meshes import write_meshes

    for part in write_meshes(
        (result,), config.dictionary, folder, config.export.format
    ):
        yield part._replace(done=0, total=None)  # its images are counted already
