"""Install shapefit a second time, in an environment of its own that borrows all other
packages.

Usage: python tools/second_install.py FOLDER PIP_ARGUMENTS..., for example
    python tools/second_install.py build/plain . -C cmake.define.SHAPEFIT_LEVELS=plain

Nothing is downloaded: the packages are those of the Python that runs this. Its own
shapefit stays out of sight, for a folder named in a .pth file comes after what is
installed, and the hooks of editable installs in it are not loaded. Run
FOLDER/bin/python with -P, so that a shapefit in the working directory stays out of
sight too; what tests import beside it, CHECKOUT, is linked.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

CHECKOUT = ("benchmarks", "tools")


def main() -> None:
    """Make the environment and install the project into it."""
    folder, arguments = Path(sys.argv[1]), sys.argv[2:]
    venv.create(folder, symlinks=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "borrowed.pth").write_text(
        sysconfig.get_path("purelib") + "\n", encoding="utf-8"
    )
    for name in CHECKOUT:
        (packages / name).unlink(missing_ok=True)
        (packages / name).symlink_to(Path(name).resolve())
    options = ["--quiet", "--no-deps", "--force-reinstall", "--no-build-isolation"]
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--disable-pip-version-check",
        "--python",
        str(folder),
    ]
    done = subprocess.run([*pip, "install", *options, *arguments], check=False)
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
