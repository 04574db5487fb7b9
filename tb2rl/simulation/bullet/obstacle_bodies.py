"""Dynamic obstacles in PyBullet: bodies without mass, placed where the compiled motion says.

PyBullet does not move them, and they do not push: they stop where they run into the robot, see
`tb2rl.simulation.obstacles.motion`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tb2rl.simulation.bullet.bodies import MOVING_GROUP, WALL_GROUP, RobotBody
from tb2rl.simulation.bullet.client import pybullet
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.obstacles.dynamic_obstacles import DynamicObstacles
from tb2rl.simulation.obstacles.motion import (
    DECIDE_EVERY,
    decide,
    move_obstacles,
    out_of_reach,
    step_obstacles_alone,
)
from tb2rl.simulation.obstacles.outlines import COS, LENGTH, SIN, WIDTH, X, Y, nearest_gap
from tb2rl.simulation.spec import SimulationSpec
from tb2rl.worlds.world import WALL_HEIGHT, World

_COLOUR = (0.49, 0.31, 0.63, 1.0)  # as in pictures from above
_NEAR = 0.1  # [m] what is farther away does not touch


class ObstacleBodies:
    """Bodies for outlines, made as they are needed.

    Args:
        client: The PyBullet client.
    """

    def __init__(self, client: int) -> None:
        self._client = client
        self._sizes: list[tuple[float, float]] = []
        self.numbers: list[int] = []  # of the bodies

    def place(self, outlines: np.ndarray) -> None:
        """Show these obstacles and no others, see `RobotState.dynamic_obstacles`: shape (obstacles, 6)."""
        present = outlines[outlines[:, LENGTH] > 0.0]
        sizes = [(length, width) for length, width in present[:, [LENGTH, WIDTH]].tolist()]
        if sizes != self._sizes:
            for body in self.numbers:
                pybullet.removeBody(body, self._client)
            self._sizes, self.numbers = sizes, [self._add(*size) for size in sizes]
        for body, (x, y, cos, sin) in zip(self.numbers, present[:, [X, Y, COS, SIN]].tolist(), strict=True):
            half = math.atan2(sin, cos) / 2
            turn = (0.0, 0.0, math.sin(half), math.cos(half))
            pybullet.resetBasePositionAndOrientation(body, (x, y, WALL_HEIGHT / 2), turn, self._client)

    def _add(self, length: float, width: float) -> int:
        if width == 0.0:
            kind, size = pybullet.GEOM_CYLINDER, dict[str, Any](radius=length)
            collision = pybullet.createCollisionShape(kind, **size, height=WALL_HEIGHT, physicsClientId=self._client)
            size["length"] = WALL_HEIGHT
        else:
            kind, size = pybullet.GEOM_BOX, dict[str, Any](halfExtents=(length, width, WALL_HEIGHT / 2))
            collision = pybullet.createCollisionShape(kind, **size, physicsClientId=self._client)
        visual = pybullet.createVisualShape(kind, **size, rgbaColor=_COLOUR, physicsClientId=self._client)
        body = pybullet.createMultiBody(0.0, collision, visual, physicsClientId=self._client)
        pybullet.setCollisionFilterGroupMask(body, -1, WALL_GROUP, MOVING_GROUP, physicsClientId=self._client)
        return body


class BulletObstacles(DynamicObstacles):
    """The dynamic obstacles of the one robot of a PyBullet client, with their bodies.

    Args:
        spec: The worlds and their dynamic obstacles.
    """

    def __init__(self, spec: SimulationSpec) -> None:
        super().__init__(spec, 1)
        self._radius = spec.robot.radius
        self._alone = False  # whether the obstacles have completed this control step already

    def connect(self, client: int) -> None:
        """Have bodies in a PyBullet client from now on."""
        self._client, self._bodies = client, ObstacleBodies(client)

    def start(self, initial_state: InitialState, world: World) -> None:
        """Place the obstacles for an episode."""
        self.reset_at(np.zeros(1, dtype=int), initial_state, world.index, np.zeros(1, dtype=int))

    def place(self) -> None:
        """Move the bodies to where the obstacles are."""
        self._bodies.place(self.outlines[0])

    def run_physics(
        self, numbers: range, steps: int, duration: float, robot: RobotBody, initial_state: InitialState, world: World
    ) -> bool:
        """Run some steps of the physics, in each of which the obstacles go first; out of reach, they go all at once.

        Args:
            numbers: Of the physics steps in their control step, from 0.
            steps: How many the control step has.
            duration: Of a physics step [s].
            robot: The robot.
            initial_state: Of its episode.
            world: Its world.

        Returns:
            Whether the robot and an obstacle touched.
        """
        initial = initial_state.rows
        if numbers.start == 0 < numbers.stop:
            self._alone = self._step_alone(steps, duration, robot, initial, world)
        touched = False
        for number in numbers:
            if self._alone:
                pybullet.stepSimulation(self._client)
                continue
            x, y, vx, vy = self._motion(robot)
            if number % DECIDE_EVERY == 0:
                span = min(DECIDE_EVERY, steps - number) * duration
                decide(0, span, self.arrays, initial, world.index, 0, (x, y, vx, vy))
            touched = self._step(duration, x, y, robot, world) or touched
        return touched

    def _motion(self, robot: RobotBody) -> tuple[float, float, float, float]:
        """Position [m] and velocity [m/s] of the robot."""
        (x, y, _), ((vx, vy, _), _) = robot.pose(), pybullet.getBaseVelocity(robot.body, self._client)
        return x, y, vx, vy

    def _step_alone(self, steps: int, duration: float, robot: RobotBody, initial: np.ndarray, world: World) -> bool:
        """If the robot is out of reach, step the obstacles through the whole control step."""
        x, y, vx, vy = self._motion(robot)
        speed = max(math.hypot(vx, vy), float(initial["max_speed"][0] * initial["wheel_radius"][0]))
        if not out_of_reach(x, y, speed, steps * duration, self._radius + _NEAR, self.arrays.obstacles, 0):
            return False
        step_obstacles_alone(0, steps, duration, self.arrays, initial, world.index, 0, x, y)
        self.place()
        return True

    def _step(self, duration: float, x: float, y: float, robot: RobotBody, world: World) -> bool:
        touched = move_obstacles(0, duration, self.arrays, world.index, 0, x, y, self._radius)
        self.place()
        pybullet.stepSimulation(self._client)
        if touched or nearest_gap(x, y, self.arrays.obstacles, 0) > self._radius + _NEAR:
            return touched
        return robot.touches(self._bodies.numbers)
