"""Signatures of the extension module."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
States = NDArray[np.uint64]

LEVEL: str
LEVELS: tuple[str, ...]
STRETCH: int

class parts:
    @staticmethod
    def correlate(Y: Floats, atoms: Floats, N: Floats) -> None: ...
    @staticmethod
    def largest_nuclear_norm(N: Floats) -> float: ...
    @staticmethod
    def moreau(
        M: Floats, N: Floats, step: float, dN: Floats, sigma: float, t: float, total: Floats
    ) -> float: ...
    @staticmethod
    def derivative(
        argument: Floats,
        t: float,
        sigma: float,
        resolvent: bool,
        atom: Floats,
        moved: Floats,
        prox: Floats,
        weighted: Floats,
        rows: Floats,
    ) -> int: ...
    @staticmethod
    def solve_gram(
        F: Floats, f: Floats, r: Floats, C: Floats, shift: float, by_rows: bool, x: Floats
    ) -> None: ...
    @staticmethod
    def curvature(omega: Floats, curvature: Floats, rows: Floats, matrix: Floats) -> None: ...
    @staticmethod
    def reduce(X: Floats, omega: Floats, out: Floats) -> int: ...
    @staticmethod
    def expand(y: Floats, omega: Floats, out: Floats) -> int: ...
    @staticmethod
    def soft_squared(
        E: Floats, Y: Floats, step: float, D: Floats, rho: Floats, threshold: float
    ) -> float: ...
    @staticmethod
    def climb(blocks: Floats, R: Floats) -> float: ...
    @staticmethod
    def root_cells(vertices: Floats, cells: Indices) -> None: ...
    @staticmethod
    def judge_cell(
        W: Floats,
        omega: Floats,
        atoms: Floats,
        lam: Floats,
        is_signed: bool,
        corners: Floats,
        cut: float,
        excess: Floats,
    ) -> bool: ...
    @staticmethod
    def descend(
        W: Floats,
        omega: Floats,
        atoms: Floats,
        lam: Floats,
        is_signed: bool,
        q: Floats,
        share: float,
    ) -> float: ...
    @staticmethod
    def polar_rotation(A: Floats, R: Floats) -> bool: ...
    @staticmethod
    def draw_triple(candidates: Indices, state: States, triple: Indices) -> None: ...
    @staticmethod
    def pose_triple(w: Floats, S: Floats, triple: Indices, R: Floats) -> float: ...
    @staticmethod
    def find_area(w: Floats, visible: Indices) -> float: ...
    @staticmethod
    def find_moments(
        w: Floats,
        h: Floats,
        S: Floats,
        inliers: Flags,
        P: Floats,
        D: Floats,
        middle: Floats,
        origin: Floats,
    ) -> None: ...
    @staticmethod
    def judge(
        w: Floats,
        h: Floats,
        S: Floats,
        s: float,
        R: Floats,
        T: Floats,
        threshold: float,
        area: float,
        lanes: bool,
        inliers: Flags,
    ) -> float: ...
    @staticmethod
    def log_of_one_plus(x: Floats, logarithm: Floats) -> None: ...
    @staticmethod
    def minimise_on_sphere(G: Floats, g: Floats, radius: float, y: Floats) -> float: ...
    @staticmethod
    def project_perspective(
        landmarks: Floats,
        weights: Floats,
        atoms: Floats,
        focal: Floats,
        centre: Floats,
        sign: float,
        rotation: Floats,
        translation: Floats,
        coefficients: Floats,
        X: Floats,
        r: Floats,
    ) -> None: ...
    @staticmethod
    def symmetric_eigen(A: Floats, values: Floats, V: Floats) -> None: ...
    @staticmethod
    def scaled_coefficients(Q: Floats, h: Floats, a: Floats, x: Floats) -> None: ...
    @staticmethod
    def sparse_coefficients(
        w: Floats, atoms: Floats, R: Floats, lam: float, is_signed: bool, c: Floats
    ) -> float: ...
    @staticmethod
    def alternate_image(
        w: Floats,
        atoms: Floats,
        lam: float,
        is_signed: bool,
        tolerance: float,
        R: Floats,
        c: Floats,
        trace: Floats,
    ) -> tuple[int, bool]: ...
    @staticmethod
    def rotation_step(P: Floats, D: Floats, free_scale: bool, R: Floats) -> tuple[float, float]: ...
    @staticmethod
    def rotation_value(P: Floats, D: Floats, free_scale: bool, R: Floats) -> float: ...
    @staticmethod
    def rotation_model(
        P: Floats, D: Floats, free_scale: bool, R: Floats, g: Floats, H: Floats
    ) -> tuple[float, float]: ...
    @staticmethod
    def truncated_cg(g: Floats, H: Floats, radius: float, step: Floats) -> tuple[bool, float]: ...
    @staticmethod
    def retract(R: Floats, step: Floats, out: Floats) -> None: ...
    @staticmethod
    def orthonormalise(R: Floats) -> None: ...

def alternate(
    *,
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    lam: Floats,
    starts: Floats,
    is_signed: bool,
    tolerance: float,
    most_rounds: int,
    coefficients: Floats,
    rotation: Floats,
    rounds: Indices,
    status: Indices,
    threads: int,
) -> None: ...
def find_consensus(
    *,
    landmarks: Floats,
    squares: Floats,
    shape: Floats,
    seeds: States,
    threshold: float,
    draws: int,
    max_rounds: int,
    inliers: Flags,
    threads: int,
) -> None: ...
def pursue(
    *,
    landmarks: Floats,
    weights: Floats,
    shapes: Floats,
    limbs: Floats,
    length: float,
    goal: float,
    change: float,
    most_atoms: int,
    most_rounds: int,
    coefficients: Floats,
    cameras: Floats,
    errors: Floats,
    rounds: Indices,
    status: Indices,
    threads: int,
) -> None: ...
def refine_perspective(
    *,
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    prior: Floats,
    focal: Floats,
    centre: Floats,
    sign: float,
    ridge: float,
    softness: float,
    max_rounds: int,
    rotation: Floats,
    translation: Floats,
    coefficients: Floats,
    objective: Floats,
    rounds: Indices,
    status: Indices,
    threads: int,
) -> None: ...
def find_posterior(
    *,
    landmarks: Floats,
    slopes: Floats,
    misfit: Floats,
    noise: Floats,
    log_weights: Floats,
    means: Floats,
    covariances: Floats,
    starts: Floats,
    chance: float,
    density: float,
    max_rounds: int,
    mean: Floats,
    deviation: Floats,
    correlation: Floats,
    covariance: Floats | None,
    belief: Floats,
    rotation: Floats,
    scale: Floats,
    log_evidence: Floats,
    surprise: Floats,
    rounds: Indices,
    mode_component: Indices,
    mode_rotation: Floats,
    mode_scale: Floats,
    mode_log_evidence: Floats,
    mode_mean: Floats,
    mode_covariance: Floats,
    mode_belief: Floats,
    threads: int,
) -> None: ...
def find_precisions(
    *, matrices: Floats, there: Flags, more: Floats, log_det: Floats, threads: int
) -> None: ...
def smooth_sequence(
    *,
    landmarks: Floats,
    weight: Floats,
    log_share: Floats,
    means: Floats,
    precisions: Floats,
    log_det: Floats,
    stiffness: Floats,
    bones: Indices,
    rigidity: Floats,
    hold: Floats,
    known: Floats,
    most_rounds: int,
    still: float,
    points: Floats,
    lengths: Floats,
    deviation: Floats,
    correlation: Floats,
    covariance: Floats,
    end: Floats,
) -> None: ...
def code(
    *,
    gram: Floats,
    pulls: Floats,
    smallest_moves: Floats,
    coefficients: Floats,
    unsettled: Flags,
    threads: int,
) -> None: ...
def find_objectives(
    *,
    shapes: Floats,
    atoms: Floats,
    coefficients: Floats,
    beta: float,
    objectives: Floats,
    threads: int,
) -> None: ...
def find_pose(
    *,
    shape_moments: Floats,
    landmarks_by_shape: Floats,
    starts: Floats,
    rotation: Floats,
    size: Floats,
    threads: int,
) -> None: ...
def synchronise(*, transforms: Floats, rotation: Floats, threads: int) -> None: ...
def add_products(
    *, shapes: Floats, coefficients: Floats, overlaps: Floats, pulls: Floats
) -> None: ...
def update_atoms(
    *, overlaps: Floats, pulls: Floats, atoms: Floats, bound: float, sweeps: int
) -> None: ...
def solve_convex(
    *,
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    lam: Floats,
    delta: float,
    bound: float,
    tolerance: float,
    most_steps: int,
    started: bool,
    threads: int,
    transforms: Floats,
    translation: Floats,
    dual: Floats,
    errors: Floats,
    objective: Floats,
    relative_gap: Floats,
    residual: Floats,
    steps: Indices,
    status: Indices,
) -> None: ...
def certify(
    *,
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    lam: Floats,
    delta: float,
    bound: float,
    threads: int,
    transforms: Floats,
    translation: Floats,
    dual: Floats,
    errors: Floats,
    objective: Floats,
    relative_gap: Floats,
    residual: Floats,
) -> None: ...
def find_optimum(
    *,
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    lam: Floats,
    is_signed: bool,
    starts: Floats,
    tolerance: float,
    most_cells: int,
    most_seconds: float,
    coefficients: Floats,
    rotation: Floats,
    objective: Floats,
    bound: Floats,
    cells: Indices,
    vertices: Indices,
    status: Indices,
    threads: int,
) -> None: ...
def find_modes(
    *,
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    lam: Floats,
    is_signed: bool,
    best: Floats,
    within: float,
    apart: float,
    most_cells: int,
    most_seconds: float,
    rotation: Floats,
    objective: Floats,
    count: Indices,
    valleys: Indices,
    cells: Indices,
    status: Indices,
    threads: int,
) -> None: ...
def find_coefficients(
    *,
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    lam: Floats,
    is_signed: bool,
    rotation: Floats,
    coefficients: Floats,
    objective: Floats,
    threads: int,
) -> None: ...
def record_tree(
    *,
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    lam: Floats,
    is_signed: bool,
    cut: float,
    most_cells: int,
    vertices: Floats,
    multipliers: Floats,
    splits: Indices,
) -> tuple[int, int, bool]: ...
