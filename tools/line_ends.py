"""Let each of the files end with one line end; exit code 1 where one did not."""

import sys
from pathlib import Path


def main(names: list[str]) -> int:
    """Let each file end with one line end; return 1 where any had to be changed, else
    0.
    """
    changed = [name for name in names if end_with_a_line(Path(name))]
    for name in changed:
        print(f"{name}: ends with one line end now")
    return int(bool(changed))


def end_with_a_line(path: Path) -> bool:
    """Let a file end with one line end, an empty one with none; return whether it was
    changed.
    """
    before = path.read_bytes()
    after = before.rstrip(b"\n") + b"\n" if before.strip() else b""
    if after == before:
        return False
    path.write_bytes(after)
    return True


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
