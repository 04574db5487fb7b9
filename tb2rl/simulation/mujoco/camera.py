"""Images of MuJoCo's renderer, without a display."""

import os
import sys
from contextlib import suppress
from importlib import import_module
from typing import Any

import mujoco
import numpy as np
from mujoco import MjData, MjModel

from tb2rl.core.errors import InputError, one_line

_BACKGROUND = 255  # white, as in PyBullet
_MAX_SHAPES = 10_000  # more shapes are not drawn


class CameraRenderer:
    """Renders images of one size, from models without meshes and textures.

    Raises:
        InputError: If there is no OpenGL.
    """

    def __init__(self, model: MjModel, width: int, height: int) -> None:
        self.size = width, height
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        try:
            self._window = _make_context(width, height)
            self._window.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # depends on the system's libraries, which can raise anything
            problem = one_line(f"{type(error).__name__}: {error}")
            remedy = "pip install 'tb2rl[camera]', and on Linux the libraries libegl1, libgl1-mesa-dri and libopengl0"
            raise InputError(f"MuJoCo's camera needs OpenGL, which fails here ({problem}): {remedy}") from None
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene, self._option = mujoco.MjvScene(model, _MAX_SHAPES), mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0

    def render(self, model: MjModel, data: MjData) -> tuple[np.ndarray, np.ndarray]:
        """Image from the robot's camera.

        Returns:
            Colours, shape (height, width, 3), uint8; depth along the optical axis [m], inf beyond the camera's range,
            shape (height, width), float32.
        """
        width, height = self.size
        colours, z = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        viewport, every_object = mujoco.MjrRect(0, 0, width, height), mujoco.mjtCatBit.mjCAT_ALL
        self._window.make_current()
        mujoco.mj_kinematics(model, data)  # positions of all bodies
        mujoco.mj_camlight(model, data)  # position of the camera
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, every_object, self._scene)
        mujoco.mjr_render(viewport, self._scene, self._context)
        mujoco.mjr_readPixels(colours, z, viewport, self._context)
        near, far = float(model.vis.map.znear), float(model.vis.map.zfar)
        depth = near * far / (near + z.astype(np.float64) * (far - near))  # z is 1 at `near`, and 0 at `far`
        is_far = z <= 0.0
        colours[is_far], depth[is_far] = _BACKGROUND, np.inf
        return np.flipud(colours), np.flipud(depth).astype(np.float32)

    def close(self) -> None:
        """Free the memory of OpenGL."""
        self._window.make_current()
        self._context.free()
        self._window.free()


def _make_context(width: int, height: int) -> Any:
    """OpenGL context: that of the environment variable MUJOCO_GL, or else EGL on Linux, MuJoCo's choice elsewhere."""
    with suppress(Exception):  # not installed, or broken
        import_module("triton")  # first, because after OpenGL its import, by PyTorch's optimisers, crashes the process
    if sys.platform.startswith("linux") and not os.environ.get("MUJOCO_GL"):
        from mujoco.egl import GLContext
    else:
        from mujoco import GLContext
    return GLContext(width, height)
