"""Environments in build/bench, installed as a user would: this version, the release before."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
FOLDER = PROJECT / "build" / "bench"
FIRST_BASE = "051afd75"
"""What is compared with where there is no tag yet."""


@dataclass(frozen=True)
class Environment:
    """A checkout and the environment that it is installed in."""

    name: str
    source: Path
    folder: Path

    @property
    def python(self) -> Path:
        """Its Python."""
        return self.folder / "bin" / "python"

    @property
    def command(self) -> Path:
        """Its shapefit."""
        return self.folder / "bin" / "shapefit"


def find_base() -> str:
    """Return the last tag before this commit, or FIRST_BASE."""
    told = git("describe", "--tags", "--abbrev=0", "HEAD^")
    return told.stdout.decode().strip() if told.returncode == 0 else FIRST_BASE


def base_environment(revision: str) -> Environment:
    """Install the revision, once."""
    told = git("rev-parse", "--short=12", f"{revision}^{{commit}}")
    if told.returncode:
        sys.exit(f"bench: no revision {revision} in this repository")
    folder = FOLDER / told.stdout.decode().strip()
    environment = Environment(revision, folder / "source", folder / "environment")
    if not environment.command.is_file():
        packed = git("archive", "--format=tar", revision).stdout
        with tarfile.open(fileobj=BytesIO(packed)) as archive:
            archive.extractall(environment.source, filter="data")
        install(environment)
    return environment


def this_environment() -> Environment:
    """Install what lies here: a user's installation, without the developers' tools.

    It is made anew where what it depends on has changed, else shapefit alone is.
    """
    said = b"".join((PROJECT / name).read_bytes() for name in ("pyproject.toml", "constraints.txt"))
    folder = FOLDER / f"this-{hashlib.sha256(said).hexdigest()[:12]}"
    environment = Environment("this version", PROJECT, folder)
    if not environment.command.is_file():
        install(environment)
        return environment
    build = ["-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    build += ["--no-build-isolation", "-C", "build-dir=build/{wheel_tag}", "--wheel-dir"]
    wheels = folder / "wheels"
    shutil.rmtree(wheels, ignore_errors=True)
    subprocess.run([sys.executable, *build, str(wheels), str(PROJECT)], check=True)
    pip = [
        str(environment.python),
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ]
    renew = [*pip, "--no-deps", "--force-reinstall", *map(str, wheels.glob("shapefit-*.whl"))]
    subprocess.run(renew, check=True)
    return environment


def install(environment: Environment) -> None:
    """Install a source and what it needs, with the versions that it was developed with."""
    make = [sys.executable, "-m", "venv", "--clear", str(environment.folder)]
    subprocess.run(make, check=True)
    constraints = environment.source / "constraints.txt"
    subprocess.run(
        [str(environment.python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
         "--constraint", str(constraints), str(environment.source)],
        check=True,
    )  # fmt: skip


def git(*arguments: str) -> subprocess.CompletedProcess[bytes]:
    """Run git in the project."""
    return subprocess.run(["git", *arguments], cwd=PROJECT, capture_output=True, check=False)
