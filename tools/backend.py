"""The build backend: scikit-build-core, once a C++ compiler is found.

Without a compiler pip would end in the log of CMake; here it ends in one sentence.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from typing import Any

from scikit_build_core import build

COMPILERS = ("c++", "g++", "clang++", "icpx")
HOW = {
    "linux": "apt install g++ (Debian, Ubuntu) or dnf install gcc-c++ (Fedora)",
    "darwin": "xcode-select --install",
}


def __getattr__(name: str) -> Any:
    """Return the build hook of this name of scikit-build-core; all but those of a
    source distribution first check that there is a C++ compiler.
    """
    if name in ("get_requires_for_build_sdist", "build_sdist") or name.startswith("_"):
        return getattr(build, name)
    hook = getattr(build, name)

    def check_and_call(*arguments: Any, **options: Any) -> Any:
        require_compiler()
        return hook(*arguments, **options)

    return check_and_call


def require_compiler() -> None:
    """Exit with one line that says what to install, unless a C++ compiler runs.

    Visual Studio, toolchains and arguments of CMake find theirs without PATH and CXX.
    """
    given = "CMAKE_CXX_COMPILER" in os.environ.get("CMAKE_ARGS", "")
    if given or sys.platform == "win32" or "CMAKE_TOOLCHAIN_FILE" in os.environ:
        return
    wanted = shlex.split(os.environ.get("CXX", ""))
    if wanted and not can_run(wanted[0]):
        sys.exit(
            f"shapefit needs a C++ compiler, and CXX={wanted[0]} is none: mend or unset"
            " CXX."
        )
    if not wanted and not any(map(can_run, COMPILERS)):
        how = HOW.get(sys.platform, "GCC or Clang")
        sys.exit(
            f"shapefit needs a C++ compiler to build its core. Install one: {how}."
        )


def can_run(compiler: str) -> bool:
    """Whether a compiler is installed and starts (macOS has stubs that only offer to
    install it).
    """
    path = shutil.which(compiler)
    if path is None:
        return False
    return (
        subprocess.run([path, "--version"], capture_output=True, check=False).returncode
        == 0
    )
