"""Camera images: colours, depth or both."""

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from tb2rl import robots
from tb2rl.core.errors import InputError
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState, SimulatorType

Pixels = Annotated[int, Ge(4), Le(1024)]


class Camera(Sensor):
    """A uint8 image: red, green and blue if `colour` is true, followed by depth if `depth` is true.

    Depth is measured along the optical axis. 0 is 0 m; 255 is the camera's maximum range or more.

    Args:
        camera: The robot's camera.
        colour: Whether to include colours.
        depth: Whether to include depth.
        width, height: Size of the image [px]; Stable-Baselines3's networks need at least 36.

    Raises:
        InputError: If both `colour` and `depth` are false.
    """

    name = "camera"
    low, high = 0, 255

    def __init__(
        self, camera: robots.Camera, colour: bool = False, depth: bool = True, width: Pixels = 64, height: Pixels = 64
    ) -> None:
        if not (colour or depth):
            raise InputError("a camera needs colour or depth; set one of them to true")
        self.camera, self.colour, self.depth = camera, colour, depth
        self.shape = (3 * colour + depth, height, width)

    def check(self, simulator: SimulatorType) -> None:
        if self.colour and not simulator.has_colours:
            raise InputError(f"the cameras of simulation {simulator.name!r} see depth but no colours")
        mount_height, wall_height = self.camera.position[2], simulator.max_camera_height
        if mount_height >= wall_height:
            walls = f"the walls of simulation {simulator.name!r}, which are {wall_height:g} m high"
            raise InputError(f"the camera is {mount_height:g} m high; it must be below {walls}")

    def read(self, robot_state: RobotState) -> np.ndarray:
        colours, depth = robot_state.render_camera(*self.shape[:0:-1])  # width, height
        channels = [np.moveaxis(colours, -1, 1)] if self.colour and colours is not None else []
        if self.depth:
            scaled = np.rint(np.minimum(depth * (255.0 / self.camera.range[1]), 255.0))
            channels.append(scaled.astype(np.uint8)[:, None])
        return channels[0] if len(channels) == 1 else np.concatenate(channels, axis=1)
