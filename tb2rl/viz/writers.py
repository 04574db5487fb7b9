"""Film files: pictures of one size as MP4 or GIF."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path

import av
import numpy as np
from PIL import Image, ImageColor

from tb2rl.rendering.colours import DRAWN

_GIF_COLOURS = 64

Writer = Callable[[Path, Iterator[np.ndarray], int], None]


def write_mp4(path: Path, frames: Iterator[np.ndarray], rate: int) -> None:
    """Write an MP4 file with H.264 in it: what browsers and notebooks play.

    Args:
        path: The file.
        frames: Pictures of one size with even sides, shape (height, width, 3), uint8.
        rate: Pictures a second.
    """
    with av.open(str(path.absolute()), "w", format="mp4", options={"movflags": "faststart"}) as container:
        # Drawings move little, so a short search for where they went does: 8 % larger, a sixth less work.
        options = {"preset": "veryfast", "crf": "22", "x264-params": "subme=1:me=dia"}
        stream = container.add_stream("libx264", rate=rate, options=options)
        stream.pix_fmt = "yuv420p"
        stream.thread_count = 1  # a second one costs a quarter more work, and gains little beside the drawing
        for number, frame in enumerate(frames):
            if number == 0:
                stream.height, stream.width, _ = frame.shape
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def write_gif(path: Path, frames: Iterator[np.ndarray], rate: int) -> None:
    """Write a GIF file that repeats; all pictures share one palette, so that what stays the same costs nothing.

    Args:
        path: The file.
        frames: At least one picture, all of one size, shape (height, width, 3), uint8.
        rate: Pictures a second.
    """
    first = next(frames)
    colours = Image.fromarray(_with_colours(first)).quantize(_GIF_COLOURS)
    pictures = (
        Image.fromarray(frame).quantize(palette=colours, dither=Image.Dither.NONE) for frame in chain([first], frames)
    )
    next(pictures).save(
        path, format="GIF", save_all=True, append_images=pictures, duration=1000 // rate, loop=0, optimize=True
    )


WRITERS: dict[str, tuple[Writer, int]] = {  # by the file's ending, with their most pictures a second
    ".mp4": (write_mp4, 30),
    ".gif": (write_gif, 10),
}


def _with_colours(picture: np.ndarray) -> np.ndarray:
    """The picture beside a sample of each colour that drawings have: what a palette for them is made from."""
    samples = [np.full((len(picture), 8, 3), ImageColor.getrgb(colour), dtype=np.uint8) for colour in DRAWN]
    return np.hstack([picture, *samples])
