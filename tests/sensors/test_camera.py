"""The camera as a sensor: images of uint8, channels first, as Stable-Baselines3 wants them."""

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.sensors.camera import Camera

RANGE = 8.0  # [m] of the TurtleBot2's camera


class Painted:
    """A camera with images of its own."""

    def __init__(self, colours, depth):
        self.colours, self.depth = np.asarray(colours), np.asarray(depth, np.float32)

    def render_camera(self, robot_state, width, height):
        assert self.depth.shape[1:] == (height, width)
        return self.colours, self.depth


@pytest.fixture
def camera():
    """Images of two environments, each of 2 rows and 5 columns."""
    colours = np.arange(60, dtype=np.uint8).reshape(2, 2, 5, 3)
    depth = [[[0.0, 2.0, 4.0, 8.0, np.inf]] * 2, [[1.0] * 5] * 2]
    return Painted(colours, depth)


def test_depth_is_0_at_0_m_and_255_at_the_cameras_range_and_where_nothing_was_hit(camera, make_robot_state):
    images = Camera(ROBOT.camera, width=5, height=2).read(make_robot_state(pose=[(0, 0, 0)] * 2, simulator=camera))
    assert (images.dtype, images.shape) == (np.uint8, (2, 1, 2, 5))
    assert images[0, 0].tolist() == [[0, 64, 128, 255, 255]] * 2
    assert (images[1] == round(255 / RANGE)).all()


def test_colours_come_first_and_depth_is_the_last_channel(camera, make_robot_state):
    robot_state = make_robot_state(pose=[(0, 0, 0)] * 2, simulator=camera)
    colours = Camera(ROBOT.camera, colour=True, depth=False, width=5, height=2).read(robot_state)
    both = Camera(ROBOT.camera, colour=True, width=5, height=2).read(robot_state)
    np.testing.assert_array_equal(colours, camera.colours.transpose(0, 3, 1, 2))
    np.testing.assert_array_equal(both[:, :3], colours)
    assert (both[1, 3] == round(255 / RANGE)).all()


def test_a_camera_that_sees_nothing_is_refused():
    with pytest.raises(InputError, match="needs colour or depth"):
        Camera(ROBOT.camera, colour=False, depth=False)
