"""The camera's images: colours, depth or both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le

from tb2rl import robots
from tb2rl.core.errors import InputError
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState, SimulationSpec, SimulatorType

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

    def check(self, simulator: SimulatorType) -> None:
        if self.colour and not simulator.has_colours:
            raise InputError(f"the cameras of simulation {simulator.name!r} see depth but no colours")
        height, limit = self.camera.position[2], simulator.max_camera_height
        if height >= limit:
            raise InputError(
                f"simulation {simulator.name!r} renders cameras below {limit:g} m, the height of its walls, and this "
                f"robot's is {height:g} m high"
            )

    def read(self, robot_state: RobotState) -> np.ndarray:
        colours, depth = robot_state.render_camera(*self.shape[:0:-1])
        channels = [] if colours is None or not self.colour else [np.moveaxis(colours, -1, 1)]
        if self.depth:
            scaled = np.rint(np.minimum(depth * (255.0 / self.camera.range[1]), 255.0))
            channels.append(scaled.astype(np.uint8)[:, None])
        return channels[0] if len(channels) == 1 else np.concatenate(channels, axis=1)
