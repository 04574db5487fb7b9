"""Images of PyBullet's software renderer."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.robots import Camera
from tb2rl.simulation.bullet.client import pybullet


def look_ahead(client: int, pose: np.ndarray, camera: Camera, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Image of the camera on a robot at a pose (3,), see `take_picture`."""
    x, y, yaw = pose.tolist()
    ahead, left = np.array([math.cos(yaw), math.sin(yaw), 0.0]), np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    forward, sideways, up = camera.position
    position = np.array([x, y, up]) + forward * ahead + sideways * left
    return take_picture(client, position, position + ahead, camera.field_of_view, camera.range, width, height)


def take_picture(
    client: int,
    camera: np.ndarray,
    target: np.ndarray,
    field_of_view: float,
    reach: tuple[float, float],
    width: int,
    height: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Image from one point towards another.

    Args:
        client: The PyBullet client.
        camera, target: x, y, z [m], shape (3,).
        field_of_view: Vertical [rad].
        reach: Nearest and farthest rendered depth [m].
        width, height: Of the image [px].

    Returns:
        Colours, shape (height, width, 3), uint8; depth along the optical axis [m], shape (height, width), float32, inf
        beyond the farthest.
    """
    near, far = reach
    view = pybullet.computeViewMatrix(camera, target, (0.0, 0.0, 1.0))
    projection = pybullet.computeProjectionMatrixFOV(math.degrees(field_of_view), width / height, near, far)
    _, _, rgba, buffer, _ = pybullet.getCameraImage(
        width, height, view, projection, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client
    )
    colours = np.reshape(rgba, (height, width, 4))[..., :3].astype(np.uint8)
    z = np.reshape(buffer, (height, width)).astype(np.float64)
    depth = far * near / (far - (far - near) * z)  # OpenGL's depth buffer
    return colours, np.where(z < 1.0, depth, np.inf).astype(np.float32)
