"""Lift 2D landmarks in single images to 3D shapes with a convex program.

`learn`, `fit` and `evaluate` do what the commands of those names do, on arrays;
`read_*` and `write_*` handle the files. See docs/python.md. Each is imported when it is
first used.
"""

from __future__ import annotations

TYPE_CHECKING = (
    False  # `typing` would be imported before the command can handle a signal
)
if TYPE_CHECKING:
    from shapefit.api.dictionary import Dictionary
    from shapefit.api.evaluating import Evaluation, evaluate
    from shapefit.api.files import (
        read_dictionary,
        read_landmarks,
        read_results,
        read_shapes,
        write_dictionary,
        write_landmarks,
        write_results,
        write_shapes,
    )
    from shapefit.api.fitting import fit
    from shapefit.api.learning import learn
    from shapefit.api.program import Optimum, solve
    from shapefit.errors import InputError
    from shapefit.records import Fit, Landmarks, Shapes

__version__ = "0.3.0"

__all__ = [
    "Dictionary",
    "Evaluation",
    "Fit",
    "InputError",
    "Landmarks",
    "Optimum",
    "Shapes",
    "__version__",
    "evaluate",
    "fit",
    "learn",
    "read_dictionary",
    "read_landmarks",
    "read_results",
    "read_shapes",
    "solve",
    "write_dictionary",
    "write_landmarks",
    "write_results",
    "write_shapes",
]

_PLACES = {
    "errors": ("InputError",),
    "records": ("Fit", "Landmarks", "Shapes"),
    "api.dictionary": ("Dictionary",),
    "api.files": tuple(
        name for name in __all__ if name.startswith(("read_", "write_"))
    ),
    "api.evaluating": ("Evaluation", "evaluate"),
    "api.fitting": ("fit",),
    "api.learning": ("learn",),
    "api.program": ("Optimum", "solve"),
}


if not TYPE_CHECKING:  # a checker that sees it takes every name for one of these

    def __getattr__(name: str) -> object:
        """Return a name of the package, from the module that has it."""
        import importlib

        for module, names in _PLACES.items():
            if name in names:
                return getattr(importlib.import_module(f"shapefit.{module}"), name)
        raise AttributeError(f"module 'shapefit' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the names of the package, those that are not imported yet included."""
    return sorted({*globals(), *__all__})
