"""The camera's images: colours, depth or both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le

from tb2rl import robots
from tb2rl.core.errors import InputError
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState, SimulationSpec
from tb2rl.worlds.world import WALL_HEIGHT

Pixels = Annotated[int, Ge(4), Le(1024)]


class Camera(Sensor):
    """An image of uint8 with 1, 3 or 4 channels: red, green and blue, then depth.

    Depth, along the optical axis, is 0 for 0 m and 255 for the camera's range (TurtleBot2: 8 m) and beyond.

    Args:
        camera: Of the robot.
        colour: Whether there are colours; PyBullet alone has them.
        depth: Whether there is depth.
        width, height: Of the image [px]; Stable-Baselines3's networks need 36 at least.

    Raises:
        InputError: If it would see nothing.
    """

    name = "camera"
    low, high = 0, 255

    def __init__(
        self,
        camera: robots.Camera,
        colour: bool = False,
        depth: bool = True,
        width: Pixels = 64,
        height: Pixels = 64,
    ) -> None:
        if not (colour or depth):
            raise InputError("a camera without colour and depth sees nothing")
        self.camera, self.colour, self.depth = camera, colour, depth
        self.shape = (3 * colour + depth, height, width)

    @classmethod
    def given(cls, spec: SimulationSpec) -> Mapping[str, Any]:
        return {"camera": spec.robot.camera}

    def check(self, simulation: str) -> None:
        if simulation == "bullet":
            return
        if self.colour:
            raise InputError("only simulation 'bullet' has a camera with colours; its fast twin has depth alone")
        if self.camera.position[2] >= WALL_HEIGHT:
            raise InputError(
                f"the fast twin's camera looks from below the top of the walls ({WALL_HEIGHT:g} m), and this robot's "
                f"is {self.camera.position[2]:g} m high; take simulation 'bullet'"
            )

    def read(self, robot_state: RobotState) -> np.ndarray:
        colours, depth = robot_state.render_camera(*self.shape[:0:-1])
        channels = [] if colours is None or not self.colour else [np.moveaxis(colours, -1, 1)]
        if self.depth:
            scaled = np.rint(np.minimum(depth * (255.0 / self.camera.range[1]), 255.0))
            channels.append(scaled.astype(np.uint8)[:, None])
        return channels[0] if len(channels) == 1 else np.concatenate(channels, axis=1)
