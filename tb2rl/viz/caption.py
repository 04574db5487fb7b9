"""The strip of text below the pictures of a film."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from tb2rl.envs.scene import Scene
from tb2rl.rendering.colours import BODY, FAILED, FLOOR, LABEL, STRIP
from tb2rl.viz.shots import Shot, speeds

HEIGHT = 48  # [px]
_NARROWEST = 560  # [px] width that the values need
_LABEL_SIZE, _VALUE_SIZE = 13, 19  # [px]

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont


def caption(shot: Shot, scene: Scene) -> dict[str, str]:
    """What a film says of an instant: each value by its name."""
    moment = shot.moment
    v, w = speeds(moment.before, moment.pose, scene.task.control_period)
    doing = {"ended": moment.info["ended"]} if shot.over else {"action": scene.actions.describe(moment.action)}
    return {
        "time [s]": f"{shot.time:.1f}",
        "v [m/s]": f"{v:z.2f}",
        "w [rad/s]": f"{w:+z.2f}",
        **doing,
        "reward": f"{moment.reward:+g}",
        "return": f"{moment.total:g}",
    }


def draw_caption(width: int, values: Mapping[str, str], loud: str | None = None) -> np.ndarray:
    """A strip of text: each value under its name, `loud` names one to draw in red.

    Returns:
        Shape (48, width, 3), uint8.
    """
    column, parts = width / max(1, len(values)), []
    for number, (name, value) in enumerate(values.items()):
        left, right = round(number * column), round((number + 1) * column)
        colour = FAILED if name == loud else BODY
        parts.append(_entry(name, value, right - left, (number + 0.5) * column - left, column, colour))
    return np.hstack(parts) if parts else np.full((HEIGHT, width, 3), ImageColor.getrgb(STRIP), dtype=np.uint8)


@lru_cache(maxsize=256)  # most values are those of the picture before
def _entry(name: str, value: str, width: int, middle: float, room: float, colour: str) -> np.ndarray:
    """A value under its name, in the middle of a strip; `room` is the width that they may have [px]."""
    image = Image.new("RGB", (width, HEIGHT), STRIP)
    draw = ImageDraw.Draw(image)
    draw.text((middle, 13), name, LABEL, _font(name, _LABEL_SIZE, room), anchor="mm")
    draw.text((middle, 33), value, colour, _font(value, _VALUE_SIZE, room), anchor="mm")
    return np.asarray(image)


def with_caption(picture: np.ndarray, shot: Shot, scene: Scene) -> np.ndarray:
    """The picture with its caption below; what is narrower stands in the middle. Both (height, width, 3), uint8."""
    width = max(_NARROWEST, picture.shape[1])
    loud = "ended" if shot.moment.info["failed"] else None
    return np.vstack([_widened(picture, width, FLOOR), draw_caption(width, caption(shot, scene), loud)])


@lru_cache(maxsize=256)
def _font(text: str, size: int, width: float) -> Font:
    """The font in which a text of that size [px] stays within a width [px]."""
    font = ImageFont.load_default(size)
    length = font.getlength(text) + 6
    return font if length <= width else ImageFont.load_default(size * width / length)


def _widened(picture: np.ndarray, width: int, colour: str) -> np.ndarray:
    height, present, _ = picture.shape
    if present == width:
        return picture
    wide = np.full((height, width, 3), ImageColor.getrgb(colour), dtype=np.uint8)
    left = (width - present) // 2
    wide[:, left : left + present] = picture
    return wide
