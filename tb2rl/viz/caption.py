"""The strip of text below the pictures of a film."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from tb2rl.envs.scene import Scene
from tb2rl.rendering.colours import BODY, FAILED, FLOOR, LABEL, STRIP
from tb2rl.viz.film_frames import FilmFrame

HEIGHT = 48  # [px]
_MIN_WIDTH = 560  # [px] that the values need
_LABEL_SIZE, _VALUE_SIZE = 13, 19  # [px]


def add_caption(picture: np.ndarray, frame: FilmFrame, scene: Scene) -> np.ndarray:
    """The picture above its caption, centred if it is narrower. Both (height, width, 3), uint8."""
    height, width, _ = picture.shape
    captioned = np.empty((height + HEIGHT, max(_MIN_WIDTH, width), 3), dtype=np.uint8)
    left = (captioned.shape[1] - width) // 2
    captioned[:height] = ImageColor.getrgb(FLOOR)
    captioned[:height, left : left + width] = picture
    captioned[height:] = draw_caption(captioned.shape[1], caption(frame, scene), "ended" if frame.failed else None)
    return captioned


def caption(frame: FilmFrame, scene: Scene) -> dict[str, str]:
    """Values of a frame by their names."""
    v, w = frame.twist
    status = {"ended": frame.ended} if frame.ended else {"action": scene.actions.describe(frame.action)}
    return {
        "time [s]": f"{frame.time:.1f}",
        "v [m/s]": f"{v:z.2f}",
        "w [rad/s]": f"{w:+z.2f}",
        **status,
        "reward": f"{frame.reward:+g}",
        "return": f"{frame.episode_return:g}",
    }


def draw_caption(width: int, values: Mapping[str, str], red: str | None = None) -> np.ndarray:
    """A strip with each value below its name, the one named `red` in red; shape (48, width, 3), uint8."""
    image, column = Image.new("RGB", (width, HEIGHT), STRIP), width / len(values)
    draw = ImageDraw.Draw(image)
    for number, (name, value) in enumerate(values.items()):
        centre, colour = (number + 0.5) * column, FAILED if name == red else BODY
        draw.text((centre, 13), name, LABEL, _font(name, _LABEL_SIZE, column), anchor="mm")
        draw.text((centre, 33), value, colour, _font(value, _VALUE_SIZE, column), anchor="mm")
    return np.asarray(image)


@lru_cache(maxsize=256)
def _font(text: str, size: int, width: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font of a size [px], or a smaller one if the text would exceed a width [px]."""
    font = ImageFont.load_default(size)
    length = font.getlength(text) + 6
    return font if length <= width else ImageFont.load_default(size * width / length)
