"""The method `convex`: the convex program, each transform completed to a rotation."""

from __future__ import annotations

from shapefit.convex.problem import Problem
from shapefit.lifting.estimate import ConvexProof, Estimate, fit_translation
from shapefit.lifting.methods import Settings
from shapefit.lifting.outliers.robust_loss import find_outliers
from shapefit.lifting.reconstruction import reconstruct


def lift_convex(problem: Problem, settings: Settings) -> Estimate:
    """Solve the convex program and complete each transform (paper, section Reconstruction)."""
    solution = settings.solve(problem)
    found = reconstruct(
        solution.transforms,
        problem.atoms,
        orthogonal=settings.orthogonal,
        threads=settings.threads,
    )
    residual = solution.residual
    if settings.orthogonal:  # the shapes are not those that the program was solved with
        placed = fit_translation(problem, found.shapes, solution.translation)
        residual = placed.residual
    return Estimate(
        shapes=found.shapes,
        translation=solution.translation,
        rotation=found.rotation,
        objective=solution.objective,
        residual=residual,
        iterations=solution.iterations,
        status=solution.status,
        coefficients=found.coefficients,
        active_atoms=found.active_atoms,
        transforms=solution.transforms,
        relative_gap=solution.relative_gap,
        tight=found.tight,
        outliers=find_outliers(problem, solution),
        convex_proof=ConvexProof.of(solution),
    )
