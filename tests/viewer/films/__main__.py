"""Make the films anew: `python -m tests.viewer.films`, with ffmpeg."""

import subprocess
from pathlib import Path

import numpy as np

COUNT = 36
WIDTH, HEIGHT = 320, 180
CELL = 40
"""Pixels of a cell of the barcode."""

VARIABLE = "settb=1/1000,setpts='(N+0.3*mod(N\\,3)+6*gte(N\\,12))/(25*TB)'"
H264 = ("-c:v", "libx264", "-bf", "3", "-g", "18", "-crf", "30")
VP9 = ("-c:v", "libvpx-vp9", "-b:v", "60k", "-g", "18")
FINE = ("-fps_mode", "vfr", "-enc_time_base", "1/1000")
"""Times of frames in milliseconds."""

FILMS = {
    "constant.mp4": (*H264, "-pix_fmt", "yuv420p"),
    "variable.mp4": ("-vf", VARIABLE, *FINE, *H264, "-pix_fmt", "yuv420p"),
    "constant.webm": (*VP9, "-pix_fmt", "yuv420p"),
    "variable.webm": ("-vf", VARIABLE, *FINE, *VP9, "-pix_fmt", "yuv420p"),
    "colours.mp4": ("-c:v", "libx264", "-pix_fmt", "yuv444p"),
}


def barcode(number: int) -> bytes:
    """Return the grey picture of a frame."""
    picture = np.full((HEIGHT, WIDTH), 110, np.uint8)
    for bit in range(8):
        picture[:CELL, bit * CELL : (bit + 1) * CELL] = 255 * (number >> bit & 1)
    return picture.tobytes()


def main() -> None:
    frames = b"".join(map(barcode, range(COUNT)))
    size = f"{WIDTH}x{HEIGHT}"
    given = ("-f", "rawvideo", "-pix_fmt", "gray", "-s", size, "-r", "25", "-i", "-")
    for name, options in FILMS.items():
        path = Path(__file__).with_name(name)
        line = ["ffmpeg", "-y", "-loglevel", "error", *given, *options, str(path)]
        subprocess.run(line, input=frames, check=True)


if __name__ == "__main__":
    main()
