"""The compiled kernels: C++ from this folder, in the best instruction set of the processor.

`LEVEL` names the instruction set in use, `LEVELS` all that this processor can run. The environment
variable SHAPEFIT_LEVEL forces one; InputError where there is none of that name. Functions take
C-contiguous float64 arrays, write their outputs in place and release the GIL; the rooms that call
them allocate. Arrays of another shape raise ValueError, of another type TypeError. They take the
images of a batch in stretches of STRETCH: only within one do images start from one another's
solutions. `parts` holds single steps of the kernels, for the tests that judge them one at a time.
"""

from pathlib import Path

from shapefit.errors import InputError, input_error

try:
    from shapefit.core._core import *  # noqa: F403
except ModuleNotFoundError as error:
    if error.name != "shapefit.core._core":
        raise
    # Python looks in the working directory first: a clone there hides what pip installed.
    raise input_error(
        Path(__file__).resolve().parents[1],
        "Python imports the sources of shapefit from here, and they are not compiled here",
        "start Python in another folder, or install the clone in place: pip install -e '.[plots]'",
    ) from None
except ImportError as error:
    if not str(error).startswith("SHAPEFIT_LEVEL"):
        raise
    raise InputError(f"{error}; set it to one of these, or unset it") from None
