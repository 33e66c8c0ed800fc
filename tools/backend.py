"""The build backend: scikit-build-core, once a C++ compiler is found.

Without a compiler pip would end in the log of CMake; here it ends in one sentence.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys

from scikit_build_core import build
from scikit_build_core.build import (
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_sdist,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

Settings = dict[str, str | list[str]] | None

COMPILERS = ("c++", "g++", "clang++", "icpx")

HOW = {
    "linux": "apt install g++ (Debian, Ubuntu) or dnf install gcc-c++ (Fedora)",
    "darwin": "xcode-select --install",
}


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """Ask scikit-build-core; the first hook that pip calls."""
    require_compiler()
    return build.get_requires_for_build_wheel(config_settings)


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """Ask scikit-build-core; the first hook that pip calls."""
    require_compiler()
    return build.get_requires_for_build_editable(config_settings)


def prepare_metadata_for_build_wheel(folder: str, config_settings: Settings = None) -> str:
    """Ask scikit-build-core; the first hook without build isolation."""
    require_compiler()
    return build.prepare_metadata_for_build_wheel(folder, config_settings)


def prepare_metadata_for_build_editable(folder: str, config_settings: Settings = None) -> str:
    """Ask scikit-build-core; the first hook without build isolation."""
    require_compiler()
    return build.prepare_metadata_for_build_editable(folder, config_settings)


def require_compiler() -> None:
    """Exit with one line that says what to install, unless a C++ compiler runs."""
    if chosen_elsewhere():
        return
    wanted = shlex.split(os.environ.get("CXX", ""))
    if wanted:
        if not runs(wanted[0]):
            sys.exit(
                f"shapefit needs a C++ compiler, and CXX={wanted[0]} is none: mend or unset CXX."
            )
    elif not any(map(runs, COMPILERS)):
        how = HOW.get(sys.platform, "GCC or Clang")
        sys.exit(f"shapefit needs a C++ compiler to build its core. Install one: {how}.")


def chosen_elsewhere() -> bool:
    """Where CMake finds the compiler without PATH and CXX: Visual Studio, toolchains, arguments."""
    return (
        sys.platform == "win32"
        or "CMAKE_TOOLCHAIN_FILE" in os.environ
        or "CMAKE_CXX_COMPILER" in os.environ.get("CMAKE_ARGS", "")
    )


def runs(compiler: str) -> bool:
    """Whether the compiler is there and starts (macOS has stubs that only offer to install)."""
    path = shutil.which(compiler)
    if path is None:
        return False
    return subprocess.run([path, "--version"], capture_output=True, check=False).returncode == 0
