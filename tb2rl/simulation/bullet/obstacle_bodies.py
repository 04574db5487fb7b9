"""Dynamic obstacles in PyBullet: bodies without mass, at the positions from `tb2rl.simulation.obstacles.motion`."""

import math

import numpy as np

from tb2rl.simulation.bullet.bodies import ROBOT_GROUP, WALL_GROUP, RobotBody
from tb2rl.simulation.bullet.client import pybullet
from tb2rl.simulation.obstacles import motion
from tb2rl.simulation.obstacles.dynamic_obstacles import SimulatedObstacles
from tb2rl.simulation.obstacles.outlines import COS, LENGTH, SIN, WIDTH, X, Y, distance_to_nearest
from tb2rl.simulation.spec import InitialState, SimulationSpec
from tb2rl.worlds.world import WALL_HEIGHT

_COLOUR = (0.49, 0.31, 0.63, 1.0)  # as in pictures from above
_CONTACT_CHECK_DISTANCE = 0.1  # [m] an obstacle farther from the robot cannot be in contact


class ObstacleBodies:
    """Bodies of dynamic obstacles in a PyBullet client, made when `place` needs them."""

    def __init__(self, client: int) -> None:
        self._client, self._sizes = client, list[tuple[float, float]]()
        self.bodies: list[int] = []  # PyBullet's numbers of the bodies

    def place(self, outlines: np.ndarray) -> None:
        """Put bodies at these obstacles only; outlines (obstacles, 6) as in `RobotState.dynamic_obstacles`."""
        present = outlines[outlines[:, LENGTH] > 0.0]
        sizes = [(length, width) for length, width in present[:, [LENGTH, WIDTH]].tolist()]
        if sizes != self._sizes:
            for body in self.bodies:
                pybullet.removeBody(body, self._client)
            self._sizes, self.bodies = sizes, [self._add(*size) for size in sizes]
        for body, (x, y, cos, sin) in zip(self.bodies, present[:, [X, Y, COS, SIN]].tolist(), strict=True):
            half_yaw = math.atan2(sin, cos) / 2
            orientation = (0.0, 0.0, math.sin(half_yaw), math.cos(half_yaw))
            pybullet.resetBasePositionAndOrientation(body, (x, y, WALL_HEIGHT / 2), orientation, self._client)

    def _add(self, length: float, width: float) -> int:
        shape = pybullet.GEOM_CYLINDER if width == 0.0 else pybullet.GEOM_BOX  # PyBullet ignores sizes of the other
        size = {"radius": length, "halfExtents": (length, width, WALL_HEIGHT / 2), "physicsClientId": self._client}
        collision = pybullet.createCollisionShape(shape, height=WALL_HEIGHT, **size)
        visual = pybullet.createVisualShape(shape, length=WALL_HEIGHT, rgbaColor=_COLOUR, **size)
        body = pybullet.createMultiBody(0.0, collision, visual, physicsClientId=self._client)
        pybullet.setCollisionFilterGroupMask(body, -1, WALL_GROUP, ROBOT_GROUP, physicsClientId=self._client)
        return body


class BulletObstacles(SimulatedObstacles):
    """The dynamic obstacles of the robot in a PyBullet client, and their bodies.

    Attributes:
        touched: Whether an obstacle touched the robot in this control step.
    """

    def __init__(self, spec: SimulationSpec) -> None:
        super().__init__(spec, 1)
        self._radius, self.touched = spec.robot.radius, False

    def connect(self, client: int) -> None:
        """Put the bodies into this PyBullet client from now on."""
        self._client, self._bodies = client, ObstacleBodies(client)

    def place(self) -> None:
        """Move the bodies to the positions of the obstacles."""
        self._bodies.place(self.outlines[0])

    def begin_step(self, steps: int, duration: float, robot: RobotBody, initial_state: InitialState) -> bool:
        """Begin a control step; the obstacles complete it here if the robot is out of their reach.

        Args:
            steps: Number of physics steps in the control step.
            duration: Duration of a physics step [s].
            robot: The robot.
            initial_state: Initial state of the episode.

        Returns:
            Whether the obstacles have completed the control step. If not, `step` must run each physics step.
        """
        self._steps, self._duration, self.touched = steps, duration, False
        if not self.table.shape[1]:
            return True
        self._robot, self._records = robot, initial_state.records
        self._world_arguments = self._spec.spatial_index, int(initial_state.world[0])
        (x, y, vx, vy), records = self._robot_motion(), self._records
        max_speed = max(math.hypot(vx, vy), float(records["max_speed"][0] * records["wheel_radius"][0]))
        radius = self._radius + _CONTACT_CHECK_DISTANCE
        is_complete = motion.is_out_of_reach(x, y, max_speed, steps * duration, radius, self.arrays.obstacles, 0)
        if is_complete:
            motion.step_obstacles_alone(0, steps, duration, self.arrays, records, *self._world_arguments, (x, y))
            self.place()
        return is_complete

    def step(self, number: int) -> None:
        """Run a physics step of the control step; `number` counts from 0. The obstacles move before the robot."""
        robot_motion, arrays = self._robot_motion(), self.arrays
        x, y = robot_motion[:2]
        period, world = (number, self._steps, self._duration), (self._records, *self._world_arguments)
        touched = motion.step_obstacles(0, *period, arrays, *world, robot_motion)
        self.place()
        pybullet.stepSimulation(self._client)
        if not touched and distance_to_nearest(x, y, arrays.obstacles, 0) <= self._radius + _CONTACT_CHECK_DISTANCE:
            touched = self._robot.touches(self._bodies.bodies)
        self.touched = self.touched or touched

    def _robot_motion(self) -> tuple[float, float, float, float]:
        """Position [m] and velocity [m/s] of the robot."""
        (x, y, _), ((vx, vy, _), _) = self._robot.pose(), pybullet.getBaseVelocity(self._robot.body, self._client)
        return x, y, vx, vy
