"""The tiled floor and the sky behind the pictures of the chase camera, drawn without the physics."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

EYE, TARGET = (-1.4, 0.0, 1.3), (0.5, 0.0, 0.1)  # [m] of the chase camera, in the robot's frame
FIELD_OF_VIEW = math.radians(55.0)  # [rad] vertical
_FLOOR_COLOUR = np.array((244, 241, 234), dtype=np.float32)
_SKY_COLOUR = (255, 255, 255)
_TILE_CONTRAST = 34.0  # of 255


def draw_floor(pose: tuple[float, float, float], width: int, height: int) -> np.ndarray:
    """The floor and the sky as the chase camera sees them, behind all else.

    Args:
        pose: Of the robot that the camera follows: x [m], y [m], yaw [rad].
        width, height: Of the picture [px].

    Returns:
        Shape (height, width, 3), uint8.
    """
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    ahead, left, contrast, sky = _seen_floor(width, height)
    east, north = x + cos * ahead - sin * left, y + sin * ahead + cos * left
    dark = (np.floor(east) + np.floor(north)) % 2 * contrast
    colours = (_FLOOR_COLOUR - dark[..., None] * _TILE_CONTRAST).astype(np.uint8)
    colours[:sky] = _SKY_COLOUR
    return colours


@lru_cache(maxsize=4)
def _seen_floor(width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Where in the robot's frame the chase camera's pixels see the floor.

    Returns:
        Metres ahead and to the left, and the contrast of the tiles there, each of shape (height, width), float32;
        the number of rows above the horizon.
    """
    camera, target = np.array(EYE), np.array(TARGET)
    forward = (target - camera) / np.linalg.norm(target - camera)
    right = np.array([0.0, -1.0, 0.0])
    up = np.cross(right, forward)
    reach = math.tan(FIELD_OF_VIEW / 2)
    across = (np.arange(width) + 0.5 - width / 2) * 2 * reach / height
    upward = (height / 2 - np.arange(height) - 0.5) * 2 * reach / height
    rays = forward + upward[:, None, None] * up + across[None, :, None] * right
    sky = int((rays[:, 0, 2] > -1e-3).sum())
    distance = camera[2] / np.maximum(-rays[..., 2], 1e-3)
    ahead, left = camera[0] + distance * rays[..., 0], distance * rays[..., 1]
    contrast = 1.0 / (1.0 + (distance / 5.0) ** 2)  # tiles far away are smaller than a pixel and would flicker
    return ahead.astype(np.float32), left.astype(np.float32), contrast.astype(np.float32), sky
