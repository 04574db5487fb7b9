"""The cameras of a film: the world from above, and the robot in 3D from behind."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from tb2rl.envs.scene import Scene
from tb2rl.rendering.above import WorldPicture
from tb2rl.simulation import InitialState, check_bullet
from tb2rl.simulation.obstacles.outlines import cast_all_at_movers
from tb2rl.viz.pictures import goal_of
from tb2rl.viz.shots import Shot
from tb2rl.worlds.geometry import cast_many

_CHASE_SIZE = (640, 360)  # [px]


class Camera(Protocol):
    """What films a drive."""

    rate: int  # pictures a second, at most

    def picture(self, shot: Shot) -> np.ndarray:
        """The world at an instant, shape (height, width, 3), uint8, with even sides."""

    def close(self) -> None:
        """Free what the camera holds."""


class AboveCamera:
    """The world from above, with the robot's beams and its path."""

    rate = 15

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._beams = np.cos(scene.laser.angles), np.sin(scene.laser.angles)
        self._ranges = np.empty((1, len(scene.laser.angles)))
        self._initial_state: InitialState | None = None

    def picture(self, shot: Shot) -> np.ndarray:
        if shot.moment.initial_state is not self._initial_state:
            self._begin(shot.moment.initial_state)
        return self._picture.draw(shot.pose, self._ranges_at(shot), [*shot.path, shot.pose], shot.dynamic_obstacles)

    def _ranges_at(self, shot: Shot) -> np.ndarray:
        """Along the beams [m], shape (beams,); in a world without walls as the robot read them, for it may be real."""
        obstacles = len(self._world.boxes) + len(self._world.posts)
        if shot.moment.ranges is not None and shot.dynamic_obstacles is None and not obstacles:
            return shot.moment.ranges
        cast_many(shot.pose[None], np.zeros(1), *self._beams, *self._world.index, self._ranges)
        if shot.dynamic_obstacles is not None:
            cast_all_at_movers(shot.pose[None], *self._beams, shot.dynamic_obstacles[None], self._ranges)
        return self._ranges[0]

    def _begin(self, initial_state: InitialState) -> None:
        """Draw what stands still in an episode."""
        scene = self._scene
        self._initial_state, self._world = initial_state, scene.spec.worlds[int(initial_state.world[0])]
        self._picture = WorldPicture(self._world, scene.robot, scene.laser, goal_of(scene.task, initial_state))

    def close(self) -> None:
        pass


class ChaseCamera:
    """The robot in 3D, from behind and above."""

    rate = 10  # a picture takes several times as long as one from above

    def __init__(self, scene: Scene) -> None:
        check_bullet("camera 'chase' (unlike 'above')")
        from tb2rl.viz.stage import Stage  # PyBullet may be missing

        self._task, self._stage = scene.task, Stage(scene.spec)

    def picture(self, shot: Shot) -> np.ndarray:
        initial_state = shot.moment.initial_state
        self._stage.begin(int(initial_state.world[0]), goal_of(self._task, initial_state))
        self._stage.place(shot.pose, shot.dynamic_obstacles)
        return self._stage.chase(*_CHASE_SIZE)

    def close(self) -> None:
        self._stage.close()


CAMERAS: dict[str, type[AboveCamera] | type[ChaseCamera]] = {"above": AboveCamera, "chase": ChaseCamera}
