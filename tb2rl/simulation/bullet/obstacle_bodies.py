"""What moves beside the one robot of a PyBullet client: bodies without mass, put where compiled code says.

PyBullet does not move them, and they do not push: they stop where they run into the robot, see
`tb2rl.simulation.obstacles.motion`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.simulation.bullet.bodies import MOVING_GROUP, TOUCH, WALL_GROUP, RobotBody
from tb2rl.simulation.bullet.client import pybullet
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.obstacles.dynamic_obstacles import DynamicObstacles, dynamic_obstacles_of
from tb2rl.simulation.obstacles.motion import THINK, out_of_reach, step_obstacles_alone, think, walk
from tb2rl.simulation.obstacles.outlines import COS, LENGTH, SIN, WIDTH, X, Y, nearest_mover
from tb2rl.simulation.spec import MAX_SPEED, WHEEL, SimulationSpec
from tb2rl.worlds.world import WALL_HEIGHT, World

_COLOUR = (0.49, 0.31, 0.63, 1.0)  # as in pictures from above
_NEAR = 0.1  # [m] what is farther away does not touch


class MoverBodies:
    """Bodies for the outlines of movers, made as they are needed.

    Args:
        client: The PyBullet client.
    """

    def __init__(self, client: int) -> None:
        self._client = client
        self._sizes: list[tuple[float, float]] = []
        self.numbers: list[int] = []  # of the bodies

    def place(self, outlines: np.ndarray) -> None:
        """Show movers and no others, see `RobotState.dynamic_obstacles`: (movers, 6)."""
        there = outlines[outlines[:, LENGTH] > 0.0]
        sizes = [(length, width) for length, width in there[:, [LENGTH, WIDTH]].tolist()]
        if sizes != self._sizes:
            for body in self.numbers:
                pybullet.removeBody(body, self._client)
            self._sizes, self.numbers = sizes, [self._add(*size) for size in sizes]
        for body, (x, y, cos, sin) in zip(self.numbers, there[:, [X, Y, COS, SIN]].tolist(), strict=True):
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


class Crowd:
    """The movers of a simulation of one robot, with their bodies; none, where nothing moves.

    Args:
        spec: The worlds, and what moves in them.

    Attributes:
        dynamic_obstacles: None where nothing moves.
    """

    def __init__(self, spec: SimulationSpec) -> None:
        self._radius, self.dynamic_obstacles = spec.robot.radius, dynamic_obstacles_of(spec, 1)
        self._alone = False  # whether the movers have gone through the whole of this control step already

    def join(self, client: int) -> None:
        """Have bodies in a PyBullet client from now on."""
        self._client, self._bodies = client, MoverBodies(client)

    def begin(self, initial_state: InitialState, world: World) -> None:
        """Let the movers be where an episode begins."""
        if self.dynamic_obstacles is not None:
            self.dynamic_obstacles.begin(np.zeros(1, dtype=int), initial_state, world.index, np.zeros(1, dtype=int))

    def place(self) -> None:
        """Put the bodies where the movers are."""
        if self.dynamic_obstacles is not None:
            self._bodies.place(self.dynamic_obstacles.outlines[0])

    def advance(
        self,
        first: int,
        last: int,
        steps: int,
        part: float,
        robot: RobotBody,
        initial_state: InitialState,
        world: World,
    ) -> bool:
        """Run some steps of the physics, in each of which the movers go first; out of reach, they go all at once.

        Args:
            first, last: Numbers of the physics steps in their control step, from 0; without the last one.
            steps: How many the control step has.
            part: Duration of a physics step [s].
            robot: What drives.
            start: How its episode began.
            world: What it is in.

        Returns:
            Whether the robot and a mover touched.
        """
        if first == 0 < last:
            self._alone = self._walk_alone(steps, part, robot, initial_state, world)
        if self._alone:
            for _ in range(first, last):
                pybullet.stepSimulation(self._client)
            return False
        touched = False
        for number in range(first, last):
            if number % THINK == 0:
                self._think(min(THINK, steps - number) * part, robot, initial_state, world)
            touched = self._step(part, robot, world) or touched
        return touched

    def _walk_alone(self, steps: int, part: float, robot: RobotBody, initial_state: InitialState, world: World) -> bool:
        """Where the robot is out of reach, move all through the control step at once; else say False."""
        (x, y, _), dynamic_obstacles = robot.pose(), self._there
        (vx, vy, _), _ = pybullet.getBaseVelocity(robot.body, self._client)
        speed = max(math.hypot(vx, vy), float(initial_state.table[0, MAX_SPEED] * initial_state.table[0, WHEEL]))
        if not out_of_reach(x, y, speed, steps * part, self._radius + _NEAR, dynamic_obstacles.table, 0):
            return False
        step_obstacles_alone(
            0,
            steps,
            part,
            dynamic_obstacles.table,
            dynamic_obstacles.walks,
            dynamic_obstacles.routes,
            initial_state.table,
            *world.index,
            0,
            x,
            y,
        )
        self.place()
        return True

    def _think(self, span: float, robot: RobotBody, initial_state: InitialState, world: World) -> None:
        (x, y, _), dynamic_obstacles = robot.pose(), self._there
        (vx, vy, _), _ = pybullet.getBaseVelocity(robot.body, self._client)
        think(
            0,
            span,
            dynamic_obstacles.table,
            dynamic_obstacles.walks,
            initial_state.table,
            *world.index,
            0,
            x,
            y,
            vx,
            vy,
        )

    def _step(self, part: float, robot: RobotBody, world: World) -> bool:
        (x, y, _), dynamic_obstacles = robot.pose(), self._there
        hit = walk(0, part, dynamic_obstacles.table, dynamic_obstacles.routes, *world.index, 0, x, y, self._radius)
        self.place()
        pybullet.stepSimulation(self._client)
        if hit or nearest_mover(x, y, dynamic_obstacles.table, 0) > self._radius + _NEAR:
            return hit
        contacts = pybullet.getContactPoints(robot.body, physicsClientId=self._client)
        return any(contact[2] in self._bodies.numbers and contact[8] < TOUCH for contact in contacts)

    @property
    def outlines(self) -> np.ndarray | None:
        """Where the movers are, see `RobotState.dynamic_obstacles`, as an array of its own."""
        return None if self.dynamic_obstacles is None else self.dynamic_obstacles.outlines.copy()

    def state(self) -> dict[str, Any]:
        """All that the movers' future depends on, as "dynamic_obstacles"; nothing, where nothing moves."""
        return {} if self.dynamic_obstacles is None else {"dynamic_obstacles": self.dynamic_obstacles.state()}

    def restore(self, state: Mapping[str, Any], initial_state: InitialState) -> None:
        """Let the movers go on from a `state`, in an episode that began with `start`.

        Raises:
            ValueError: If it is not of such movers.
        """
        if self.dynamic_obstacles is not None:
            self.dynamic_obstacles.restore(state["dynamic_obstacles"], initial_state)

    @property
    def _there(self) -> DynamicObstacles:
        assert self.dynamic_obstacles is not None  # nobody advances a crowd of none
        return self.dynamic_obstacles
