"""The reference physics: a robot driven by its wheels in PyBullet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tb2rl.errors import InputError
from tb2rl.robots.robot import MAX_SPEED, MAX_TURN_RATE, RADIUS, WHEEL_ACCELERATION
from tb2rl.simulation.bodies import WALL_GROUP, add_floor, add_robot, add_walls, connect
from tb2rl.simulation.camera import look_ahead
from tb2rl.simulation.odometry import believed, is_exact
from tb2rl.simulation.physics import pybullet, quiet
from tb2rl.simulation.reading import Reading
from tb2rl.simulation.scan import Scanner
from tb2rl.simulation.setup import BELIEVED_SEPARATION, FRICTION, MASS, PHYSICS_RATE, WHEEL, Setup
from tb2rl.simulation.start import Start
from tb2rl.worlds.world import WALL_HEIGHT

_MARGIN = 0.02  # [m] for a robot that moves faster than it is told, thrown back from a wall
TOUCH = 1.0e-3  # [m] a gap below this is contact: Bullet keeps bodies apart by less
_OF_THE_CLIENT = {"_client", "_walls", "_body", "_robot", "_wheels", "_duration", "_steps"}
_AT_REST = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class BulletSimulation:
    """One robot in one world at a time.

    Args:
        setup: The robot, its laser, and the worlds. The laser is cast exactly (`tb2rl.worlds.geometry`), not by
            PyBullet.
        window: Open PyBullet's window; needs a display.

    Raises:
        InputError: If the window cannot be, or PyBullet cannot load the robot.
    """

    robots = 1

    def __init__(self, setup: Setup, window: bool = False) -> None:
        self.setup, self.laser, self._window = setup, setup.laser, window
        self._world_number, self.world = 0, setup.worlds[0]
        self._scanner = Scanner(setup.laser)
        self._rng = np.random.default_rng()
        self._put_at: tuple[Any, ...] | None = None  # position, orientation, velocity and wheels
        self._driven: list[tuple[np.ndarray, float]] = []  # commands and durations since then
        self._speed, self._command, self._acceleration = 0.0, np.zeros((1, 2)), 0.0  # of the last reading
        self._open()
        self._begin(Start.proposed(setup, 1))

    def _open(self) -> None:
        """Build the world and the robot in a new PyBullet client."""
        with quiet():
            self._client = connect(self._window)
            try:
                add_floor(self._client)
                self._walls = add_walls(self._client, self.world)
                self._body = add_robot(self._client, self.setup.robot)
            except InputError:
                self.close()
                raise
        self._robot, self._wheels = self._body.body, self._body.wheels
        self._duration, self._steps = 0.0, 0

    # ---- copies, and what a process is sent: no two of them share a client

    def __getstate__(self) -> dict[str, Any]:
        if self._window:
            raise InputError("an environment with PyBullet's window cannot be copied")
        return vars(self).copy()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Drive the same way again, in a client of its own: to read the physics out and write it back would round.

        The physics depends on nothing but where the robot was put and what its wheels were told since.
        """
        vars(self).update(state)
        if self._client < 0:
            return
        self._open()
        self._body.weigh(*self._start.table[0, [MASS, FRICTION]].tolist())
        if self._put_at is not None:
            self._put(*self._put_at)
            for commands, duration in state["_driven"]:
                self._set_duration(duration)
                self.set_wheel_speeds(commands)
                self.advance()
        vars(self).update({name: value for name, value in state.items() if name not in _OF_THE_CLIENT})

    # ---- the robot's life

    def reset(self, start: Start, rng: np.random.Generator) -> Reading:
        if self._client < 0:  # it was closed
            self._open()
        self._begin(start)
        self._rng = rng
        x, y, yaw = map(float, start.pose[0])
        position, orientation = self._body.frame_at(x, y, yaw)
        self._put(position, orientation, _AT_REST, ((0.0, 0.0), (0.0, 0.0)))
        self._odometry = (x, y, yaw)
        return Reading.of_one(self._sense(bumped=False), self._start, self)

    def _begin(self, start: Start) -> None:
        """Make the world and the robot those of an episode.

        Raises:
            InputError: If the robot is to have another radius than in its URDF file.
        """
        own, wanted = self.setup.robot.parameters, start.parameters[0]
        if wanted[RADIUS] != own[RADIUS]:
            raise InputError("PyBullet takes the robot's radius from its URDF file alone")
        self._start, self._exact = start, is_exact(start)
        self._max_speed, self._max_turn_rate = float(wanted[MAX_SPEED]), float(wanted[MAX_TURN_RATE])
        # A loaded body keeps its wheels: told other speeds, they move it as the wheels of the episode would.
        self._wheel = float(start.table[0, WHEEL])
        self._turn = self._wheel * float(start.table[0, BELIEVED_SEPARATION])
        self._body.weigh(*start.table[0, [MASS, FRICTION]].tolist())
        self._torque = self.setup.robot.wheel_torque * float(wanted[WHEEL_ACCELERATION] / own[WHEEL_ACCELERATION])
        if start.world[0] != self._world_number:
            for body in self._walls:
                pybullet.removeBody(body, self._client)
            self._world_number = int(start.world[0])
            self.world = self.setup.worlds[self._world_number]
            self._walls = add_walls(self._client, self.world)

    def step(self, commands: np.ndarray, duration: float) -> Reading:
        return Reading.of_one(self.drive(commands, duration), self._start, self)

    def drive(self, commands: np.ndarray, duration: float) -> tuple[Any, ...]:
        """`step`, for `BulletBatch`: what the robot senses now, see `Reading.of_one`."""
        self._driven.append((commands.copy(), duration))
        self._set_duration(duration)
        self.set_wheel_speeds(commands)
        free, bumped = self._free_steps(duration), False
        self.advance(free)
        for _ in range(free, self._steps):  # near a wall: a touch may be shorter than a control step
            pybullet.stepSimulation(self._client)
            bumped = bumped or self._touches_a_wall()
        return self._sense(bumped)

    def _free_steps(self, duration: float) -> int:
        """How many physics steps of the control step cannot take the robot to a wall, even at its top speed."""
        gap = max(self.world.clearance(*self._place) - self.setup.robot.radius - _MARGIN, 0.0)
        return int(min(gap / max(self._max_speed * self._wheel * duration, 1e-9), 1.0) * self._steps)

    def set_wheel_speeds(self, commands: np.ndarray) -> None:
        """Tell the wheel motors the speeds for `commands` (1, 2), v [m/s] and w [rad/s]."""
        robot = self.setup.robot
        v, w = commands[0].tolist()
        v = min(max(v, -self._max_speed), self._max_speed) * self._wheel
        w = min(max(w, -self._max_turn_rate), self._max_turn_rate) * self._turn
        reach = w * robot.wheel_separation / 2
        for wheel, speed in zip(self._wheels, (v - reach, v + reach), strict=True):
            pybullet.setJointMotorControl2(
                self._robot,
                wheel,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=speed / robot.wheel_radius,
                force=self._torque,
                physicsClientId=self._client,
            )

    def advance(self, steps: int | None = None) -> None:
        """Run so many steps of the physics, None: for the duration last set.

        The bare stepping that `benchmark` compares `step` with.
        """
        client, step = self._client, pybullet.stepSimulation
        for _ in range(self._steps if steps is None else steps):
            step(client)

    def state(self) -> dict[str, Any]:
        """Base and wheels of the robot, what its sensors remember, and the start of the episode."""
        position, orientation = pybullet.getBasePositionAndOrientation(self._robot, self._client)
        velocity = pybullet.getBaseVelocity(self._robot, self._client)
        wheels = tuple(joint[:2] for joint in self._joint_states())
        # PyBullet rounds what it is given, so that without this a restored robot would differ from the present one.
        self._put(position, orientation, velocity, wheels)
        return {
            "position": position,
            "orientation": orientation,
            "velocity": velocity,
            "wheels": wheels,  # angle [rad] and rate [rad/s] of each
            "odometry": self._odometry,
            "speed": self._speed,
            "command": self._command.copy(),
            "acceleration": np.array([self._acceleration]),
            "generator": self._rng.bit_generator.state,
            "start": self._start.table.copy(),
        }

    def restore(self, state: Mapping[str, Any]) -> Reading:
        start = Start(np.array(state["start"]))
        self.setup.check_table(start.table)
        self._begin(start)
        self._put(state["position"], state["orientation"], state["velocity"], state["wheels"])
        self._odometry = tuple(state["odometry"])
        reading = Reading.of_one(self._sense(bumped=False), start, self)
        self._rng.bit_generator.state = dict(state["generator"])
        self._speed = float(state["speed"])
        self._command, self._acceleration = state["command"].copy(), float(state["acceleration"][0])
        return replace(reading, command=self._command, acceleration=np.array([self._acceleration]))

    def _put(self, position: Any, orientation: Any, velocity: Any, wheels: Any) -> None:
        self._put_at, self._driven = (position, orientation, velocity, wheels), []
        pybullet.resetBasePositionAndOrientation(self._robot, (0.0, 0.0, 100.0), (0.0, 0.0, 0.0, 1.0), self._client)
        pybullet.performCollisionDetection(self._client)  # forgets the contacts of where it was
        pybullet.resetBasePositionAndOrientation(self._robot, position, orientation, self._client)
        pybullet.resetBaseVelocity(self._robot, *velocity, self._client)
        for wheel, (angle, rate) in zip(self._wheels, wheels, strict=True):
            pybullet.resetJointState(self._robot, wheel, angle, rate, self._client)
        self._angles = tuple(angle for angle, _ in wheels)

    def close(self) -> None:
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    # ---- sensors

    def _sense(self, bumped: bool) -> tuple[Any, ...]:
        (vx, vy, _), (_, _, turn_rate) = pybullet.getBaseVelocity(self._robot, self._client)
        x, y, yaw = pose = self._body.pose()
        self._place = x, y
        ranges = self._scanner.scan(pose, self.world, self._start, self._rng)
        earlier, self._speed = self._speed, vx * math.cos(yaw) + vy * math.sin(yaw)
        command, duration = self._driven[-1] if self._driven else (np.zeros((1, 2)), math.inf)
        self._command, self._acceleration = command, (self._speed - earlier) / duration
        twist = self._speed, turn_rate
        return pose, twist, *self._count_wheels(), ranges[0], bumped, command[0], self._acceleration

    def _count_wheels(self) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Odometry: arcs of the wheels' encoders since the last call, added to the pose they give; and its speeds."""
        robot = self.setup.robot
        (left, left_rate), (right, right_rate) = (joint[:2] for joint in self._joint_states())
        step_left = (left - self._angles[0]) * robot.wheel_radius
        step_right = (right - self._angles[1]) * robot.wheel_radius
        self._angles = (left, right)
        x, y, yaw = self._odometry
        length, turn = (step_left + step_right) / 2, (step_right - step_left) / robot.wheel_separation
        rims = left_rate * robot.wheel_radius, right_rate * robot.wheel_radius
        v, w = sum(rims) / 2, (rims[1] - rims[0]) / robot.wheel_separation
        if not self._exact:
            (length, turn), (v, w) = believed(np.array([(length, turn), (v, w)]), self._start).tolist()
        if turn:
            length *= math.sin(turn / 2) / (turn / 2)  # the chord of the arc
        heading = yaw + turn / 2
        yaw = math.remainder(yaw + turn, math.tau)
        self._odometry = (x + length * math.cos(heading), y + length * math.sin(heading), yaw)
        return self._odometry, (v, w)

    def _joint_states(self) -> tuple:
        return pybullet.getJointStates(self._robot, self._wheels, self._client)

    def _touches_a_wall(self) -> bool:
        contacts = pybullet.getContactPoints(self._robot, physicsClientId=self._client)
        return any(contact[2] in self._walls and contact[8] < TOUCH for contact in contacts)  # the other one; distance

    def _set_duration(self, duration: float) -> None:
        if duration != self._duration:
            self._duration = duration
            self._steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))
            pybullet.setPhysicsEngineParameter(fixedTimeStep=duration / self._steps, physicsClientId=self._client)

    def ray_ranges(self, pose: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """PyBullet's own ranges [m] from `pose` (3,) along `angles` (beams,), to hold the exact laser against."""
        x, y, yaw = pose
        reach = self.laser.max_range
        ends = [(x + reach * math.cos(yaw + a), y + reach * math.sin(yaw + a), WALL_HEIGHT / 2) for a in angles]
        hits = pybullet.rayTestBatch(
            [(x, y, WALL_HEIGHT / 2)] * len(ends), ends, collisionFilterMask=WALL_GROUP, physicsClientId=self._client
        )
        return np.array([hit[2] * reach if hit[0] >= 0 else np.inf for hit in hits])

    def camera(self, width: int = 320, height: int = 240) -> tuple[np.ndarray, np.ndarray]:
        """What the camera on the robot's front sees.

        Returns:
            Colours, shape (height, width, 3), uint8; depth along the optical axis [m], shape (height, width), float32,
            inf beyond the sensor's range.
        """
        return look_ahead(self._client, np.array(self._body.pose()), self.setup.robot.camera, width, height)

    def look(self, reading: Reading, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """What the camera sees from where the robot was at a reading, see `Reading.look`."""
        colours, depth = look_ahead(self._client, reading.pose[0], self.setup.robot.camera, width, height)
        return colours[None], depth[None]
