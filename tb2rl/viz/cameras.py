"""The cameras of a film: the world from above, and the robot in 3D from behind. Both need `close`."""

from __future__ import annotations

import numpy as np

from tb2rl.envs.scene import Scene
from tb2rl.rendering.above import WorldPicture
from tb2rl.simulation import InitialState
from tb2rl.simulation.bullet import SIMULATOR
from tb2rl.simulation.obstacles.outlines import cast_at_outlines
from tb2rl.viz.film_frames import FilmFrame, goal_of
from tb2rl.worlds.geometry import cast_many

_CHASE_SIZE = (640, 360)  # [px]


class AboveCamera:
    """The world from above, with the robot's beams and its path."""

    rate = 15  # pictures a second, at most

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._beams = np.cos(scene.laser.angles), np.sin(scene.laser.angles)
        self._ranges = np.empty((1, len(scene.laser.angles)))
        self._initial_state: InitialState | None = None

    def picture(self, frame: FilmFrame) -> np.ndarray:
        """The world in a frame, shape (height, width, 3), uint8, with even sides."""
        if frame.initial_state is not self._initial_state:
            self._reset(frame.initial_state)
        return self._picture.draw(
            frame.pose, self._ranges_in(frame), [*frame.path, frame.pose], frame.dynamic_obstacles
        )

    def _reset(self, initial_state: InitialState) -> None:
        scene = self._scene
        self._initial_state, self._world = initial_state, scene.spec.worlds[int(initial_state.world[0])]
        self._picture = WorldPicture(self._world, scene.robot, scene.laser, goal_of(scene.task, initial_state))

    def _ranges_in(self, frame: FilmFrame) -> np.ndarray:
        """Ranges [m], shape (beams,): measured ones in a world without obstacles (a real robot's), else exact ones."""
        obstacles = len(self._world.boxes) + len(self._world.posts)
        if frame.ranges is not None and frame.dynamic_obstacles is None and not obstacles:
            return frame.ranges
        cast_many(frame.pose[None], np.zeros(1), *self._beams, *self._world.index, self._ranges)
        if frame.dynamic_obstacles is not None:
            cast_at_outlines(frame.pose[None], self._beams, frame.dynamic_obstacles[None], self._ranges)
        return self._ranges[0]

    def close(self) -> None:
        pass


class ChaseCamera:
    """The robot in 3D, from behind and above."""

    rate = 10  # lower, because a picture takes several times as long as one from above

    def __init__(self, scene: Scene) -> None:
        SIMULATOR.check("camera 'chase' (unlike 'above')")
        from tb2rl.viz.scene_view import SceneView  # PyBullet may be missing

        self._task, self._view = scene.task, SceneView(scene.spec)

    def picture(self, frame: FilmFrame) -> np.ndarray:
        """As in `AboveCamera`."""
        self._view.show_world(int(frame.initial_state.world[0]), goal_of(self._task, frame.initial_state))
        self._view.place(frame.pose, frame.dynamic_obstacles)
        return self._view.chase_picture(*_CHASE_SIZE)

    def close(self) -> None:
        self._view.close()


CAMERAS: dict[str, type[AboveCamera] | type[ChaseCamera]] = {"above": AboveCamera, "chase": ChaseCamera}
