"""The config of `fit`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from shapefit.config.commands.fit_sections import (
    ExportConfig,
    OutliersConfig,
    PosteriorConfig,
    SequencesConfig,
    ViewingConfig,
)
from shapefit.config.commands.input import InputConfig
from shapefit.config.model import (
    MOST_STEPS,
    MOST_THREADS,
    CommandConfig,
    ConfigModel,
    Height,
    section,
)
from shapefit.config.paths import (
    OF_THE_DATA,
    DictionaryPath,
    Expected,
    InputPaths,
    OptionalInputPath,
    OutputOrFolder,
    ResultFolder,
)
from shapefit.errors import listed
from shapefit.lifting.methods import (
    ALTERNATION,
    DEFAULT_VIEWS,
    METHODS,
    ROBUST,
    AlternationOptions,
    SearchOptions,
    find_conflict,
    summarise,
    those,
)

if TYPE_CHECKING:
    MethodName = str
else:
    MethodName = Literal[tuple(METHODS)]

SEARCHING = listed(those(lambda method: method.section == ALTERNATION), "and")
"""The methods that read the section `alternation`."""


def _no_robust_loss(value: Any) -> Any:
    if value in ROBUST:
        raise ValueError(f"{value} is a robust loss, which is `outliers.method: {value}`")
    return value


class SolverConfig(ConfigModel):
    """When an image counts as solved."""

    tolerance: float = Field(
        default=METHODS["convex"].tolerance,
        gt=0,
        description="An image is solved when its relative duality gap falls to this; with the "
        "method global its gap to the bound on all rotations, "
        f"{METHODS['global'].tolerance:g} by default.",
    )
    max_iterations: int = Field(default=1000, ge=1, le=MOST_STEPS)
    """Maximum iterations per image."""


_MOST_VIEWS = 1000


class AlternationConfig(ConfigModel):
    """How the methods that share one rotation alternate."""

    signed: bool = AlternationOptions.signed
    """Coefficients of either sign; without, they are >= 0."""
    views: Annotated[
        Annotated[int, Field(ge=1, le=_MOST_VIEWS)] | Literal["all"],
        Expected(f"a whole number from 1 to {_MOST_VIEWS} or all"),
    ] = Field(
        default=AlternationOptions.views,
        description="Views, spread evenly, from which the pose of the mean shape is sought; all: "
        f"from {DEFAULT_VIEWS} views, and alternate starts from each of them and keeps "
        "the lowest objective.",
    )


class SearchConfig(ConfigModel):
    """How the method global searches all rotations."""

    max_cells: int = Field(default=SearchOptions.max_cells, ge=1, le=MOST_STEPS)
    """Maximum number of cells of rotations searched per image."""
    max_seconds: float = Field(default=SearchOptions.max_seconds, gt=0)
    """Maximum seconds per image."""


class FitConfig(CommandConfig):
    """Lift 2D landmarks to 3D shapes with a dictionary."""

    COMMAND = "fit"

    landmarks: InputPaths
    """Files of 2D landmarks (- is stdin, CSV), or folders with one file per frame."""
    dictionary: DictionaryPath
    """Dictionary file that learn-dict wrote, or the name of an installed one, such as people."""
    input: InputConfig = section(InputConfig)
    output: OutputOrFolder
    """Result file to write: HDF5, or Parquet if it ends in .parquet, or tidy CSV if it ends in .csv
    or is - (stdout), or TRC, C3D, BVH or GLB by its ending (docs/export.md). A name that ends
    in / is a folder: of one result file per part, and manifest.jsonl."""
    height: Height = None
    """Height of the body or object in metres, for outputs in metres (TRC, C3D, BVH, GLB); by
    default it is as large as the training shapes of the dictionary."""
    partition: int = Field(default=100_000, ge=1)
    """With a folder as output, images per part: of a large HDF5 file, rounded up to a
    multiple of 64, or to whole sequences where those are lifted."""
    scheduler: str | None = Field(default=None, min_length=1)
    """Address of a running Dask scheduler that the parts are sent to."""
    scheduler_file: OptionalInputPath = None
    """File in which a running Dask scheduler left its address."""
    workers: int | None = Field(default=None, ge=1, le=MOST_THREADS)
    """Without a scheduler, processes of this machine that do the parts."""
    dry_run: bool = False
    """Only list the parts that would be done, done again or removed."""
    replace: bool = False
    """Replace results of other inputs or another config in the folder; without, it is refused."""
    method: MethodName = Field(default="convex", description=f"How to lift: {summarise()}.")
    loss: Annotated[Literal["squared", "exact"], BeforeValidator(_no_robust_loss)] = "squared"
    """The data term: half the squared residual; or exact, no residual at all, where lambda is
    ignored. Robust ones are methods of `outliers`."""
    lam: Annotated[
        Annotated[float, Field(gt=0)] | Literal["auto"],
        Expected("a number > 0 or auto"),
    ] = Field(default=0.1, alias="lambda")
    """Weight of the sum of spectral norms, for normalised landmarks and atoms; auto derives it from
    `noise`."""
    noise: float | None = Field(default=None, ge=0)
    """Expected standard deviation of a landmark's coordinate, in the unit of the landmarks;
    `lambda: auto` needs it. Sequences take landmarks for no more exact than
    `posterior.residual_variance` unless it says so: 0 for projected motion capture."""
    solver: SolverConfig = section(SolverConfig)
    rotations: Literal["shared", "orthogonal"] = "shared"
    """convex: how the landmarks of atoms are rotated: by the transform of each atom, or, with
    orthogonal, by the rotation nearest to it. Meshes have the one rotation nearest to all."""
    alternation: AlternationConfig = section(AlternationConfig)
    search: SearchConfig = section(SearchConfig)
    posterior: PosteriorConfig = section(PosteriorConfig)
    sequences: SequencesConfig = section(SequencesConfig)
    leave_out: Annotated[str | None, OF_THE_DATA] = Field(default=None, min_length=1)
    """Dataset of the landmarks that names, for each image, the training shape whose atoms its fit
    must not use (dictionaries of exemplars; methods without a prior); `item` if images are named
    after training shapes."""
    outliers: OutliersConfig = section(OutliersConfig)
    theta: dict[str, float] | None = None
    """How the skeleton of a detector of people differs from the joints of the dictionary, as {head:
    1.5, hips: 1.15, shoulders: 1}: the height of the top of the head above the shoulders and the
    distances of hips and shoulders, as factors. What is not given is found in the first images by
    the methods with a prior over shapes."""
    camera: ViewingConfig = section(ViewingConfig)
    export: ExportConfig = section(ExportConfig)
    threads: int = Field(default=0, ge=0, le=MOST_THREADS)
    """Threads to solve with; 0 is one per core."""
    chunk: int = Field(default=4096, ge=1, le=10_000_000)
    """Images held in memory at a time, rounded up to a multiple of 64. Results do not depend on it,
    except with `leave_out`, within the tolerance of the solver. With `method: sequences` whole
    sequences are held instead."""
    strict: bool = False
    """Count an image whose tolerance was not reached as failed."""
    transforms: bool = False
    """Also write the (k, 2, 3) transforms of every image (large)."""
    proof: bool = True
    """Also write the proof of the optimum of the convex program (the dual and the active
    transforms) for `shapefit verify` (HDF5)."""

    @property
    def labels_outliers(self) -> bool:
        """Whether the fit says which landmarks it judges wrong."""
        return self.outliers.method != "none"

    @property
    def data_term(self) -> str:
        """Return the loss of the program: that of a robust method of `outliers`, or else `loss`."""
        return self.outliers.method if self.outliers.method in ROBUST else self.loss

    @property
    def data_key(self) -> str:
        """Return the key that chose the loss of the program."""
        robust = self.outliers.method in ROBUST
        return f"outliers: {{method: {self.outliers.method}}}" if robust else f"loss: {self.loss}"

    @model_validator(mode="after")
    def _tolerance_of_the_method(self) -> Self:
        """Fill in the tolerance of the method where the config gives none."""
        if "tolerance" not in self.solver.model_fields_set:
            solver = self.solver.model_copy(update={"tolerance": METHODS[self.method].tolerance})
            object.__setattr__(self, "solver", solver)
        return self

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        named = (self.scheduler, self.scheduler_file, self.workers)
        if sum(each is not None for each in named) > 1:
            raise ValueError("`scheduler`, `scheduler_file` and `workers` exclude each other")
        if (any(named) or self.dry_run) and not isinstance(self.output, ResultFolder):
            raise ValueError(
                "a cluster writes a folder of results; end the name of the `output` with /, as in "
                "-o FOLDER/"
            )
        if self.lam == "auto" and self.noise is None:
            raise ValueError("`lambda: auto` needs `noise`; give the noise of a landmark")
        if self.outliers.method in ROBUST and self.loss != "squared":
            raise ValueError(
                f"`loss: {self.loss}` and `{self.data_key}` are both data terms; leave out one of "
                "them"
            )
        conflict = find_conflict(self)
        if conflict is not None:
            raise ValueError(conflict)
        return self
