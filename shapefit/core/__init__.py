"""The compiled kernels: C++ from this folder, in the best instruction set of the processor.

`LEVEL` names the instruction set in use, `LEVELS` all that this processor can run. The environment
variable SHAPEFIT_LEVEL forces one. Functions take C-contiguous float64 arrays, write their outputs
in place and release the GIL; the rooms that call them check and allocate. They take the images of a
batch in stretches of STRETCH: only within one do images start from one another's solutions. `parts`
holds single steps of the kernels, for the tests that judge them one at a time.
"""

from shapefit.core._core import (
    LEVEL,
    LEVELS,
    STRETCH,
    add_products,
    alternate,
    certify,
    code,
    find_coefficients,
    find_consensus,
    find_modes,
    find_objectives,
    find_optimum,
    find_pose,
    find_posterior,
    find_precisions,
    parts,
    pursue,
    record_tree,
    refine_perspective,
    smooth_sequence,
    solve_convex,
    synchronise,
    update_atoms,
)

__all__ = [
    "LEVEL",
    "LEVELS",
    "STRETCH",
    "add_products",
    "alternate",
    "certify",
    "code",
    "find_coefficients",
    "find_consensus",
    "find_modes",
    "find_objectives",
    "find_optimum",
    "find_pose",
    "find_posterior",
    "find_precisions",
    "parts",
    "pursue",
    "record_tree",
    "refine_perspective",
    "smooth_sequence",
    "solve_convex",
    "synchronise",
    "update_atoms",
]
