"""The reference physics: a robot driven by its wheels in PyBullet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.robots.robot import MAX_SPEED, MAX_TURN_RATE, RADIUS, WHEEL_ACCELERATION
from tb2rl.simulation.bullet.bodies import (
    TOUCH,
    WALL_GROUP,
    add_floor,
    add_robot,
    add_walls,
    clear,
    connect,
    disconnects,
)
from tb2rl.simulation.bullet.camera import look_ahead
from tb2rl.simulation.bullet.client import pybullet, quiet
from tb2rl.simulation.bullet.obstacle_bodies import Crowd
from tb2rl.simulation.bullet.scan import Scanner
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.odometry import encoder_odometry, is_exact
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import Generators
from tb2rl.simulation.spec import ASSUMED_SEPARATION, FRICTION, MASS, PHYSICS_RATE, WHEEL, SimulationSpec
from tb2rl.worlds.world import WALL_HEIGHT

_MARGIN = 0.02  # [m] for a robot that moves faster than it is told, thrown back from a wall
_OF_THE_CLIENT = {"_client", "_disconnect", "_walls", "_body", "_robot", "_wheels", "_duration", "_steps"}
_AT_REST = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class BulletSimulator:
    """One robot in one world at a time.

    Args:
        spec: The robot, its laser, and the worlds. The laser is cast exactly (`tb2rl.worlds.geometry`), not by
            PyBullet.
        window: Open PyBullet's window; needs a display.

    Raises:
        InputError: If the window cannot be, or PyBullet cannot load the robot.
    """

    num_envs = 1

    def __init__(self, spec: SimulationSpec, window: bool = False) -> None:
        self.spec, self.laser, self._window = spec, spec.laser, window
        self._world_number, self.world = 0, spec.worlds[0]
        self._scanner = Scanner(spec.laser)
        self._rng = np.random.default_rng()
        self._crowd = Crowd(spec)
        self._put_at: tuple[Any, ...] | None = None  # position, orientation, velocity and wheels; the movers' state
        self._driven: list[tuple[np.ndarray, float]] = []  # commands and durations since then
        self._speed, self._command, self._acceleration = 0.0, np.zeros((1, 2)), 0.0  # of the last reading
        self._open()
        self._begin(InitialState.default(spec, 1))

    def _open(self) -> None:
        """Build the world and the robot in a new PyBullet client."""
        with quiet():
            self._client = connect(self._window)
            self._disconnect = disconnects(self, self._client)
            try:
                self._build()
            except InputError:
                self.close()
                raise

    def _build(self) -> None:
        """Always all of it: what touches rounds by which bodies were there before, so to exchange some is not exact."""
        add_floor(self._client)
        self._walls = add_walls(self._client, self.world)
        self._body = add_robot(self._client, self.spec.robot)
        self._robot, self._wheels = self._body.body, self._body.wheels
        self._duration, self._steps = 0.0, 0
        self._crowd.join(self._client)

    # ---- copies, and what a process is sent: no two of them share a client

    def __getstate__(self) -> dict[str, Any]:
        if self._window:
            raise InputError("an environment with PyBullet's window cannot be copied")
        return {name: value for name, value in vars(self).items() if name != "_disconnect"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Drive the same way again, in a client of its own: to read the physics out and write it back would round."""
        # All depends on where it was put and what its wheels were told since, but for the last digits of a drive in 300
        # among posts side by side: whatever was touched at once in an earlier episode in this world counts, too.
        vars(self).update(state)
        if self._client < 0:
            return
        self._open()
        self._body.weigh(*self._initial_state.table[0, [MASS, FRICTION]].tolist())
        if self._put_at is not None:
            *where, crowd = self._put_at
            self._crowd.restore(crowd, self._initial_state)
            self._put(*where)
            for commands, duration in state["_driven"]:
                self.set_duration(duration)
                self.set_wheel_speeds(commands)
                self.advance()
        vars(self).update({name: value for name, value in state.items() if name not in _OF_THE_CLIENT})

    # ---- the robot's life

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        if self._client < 0:  # it was closed
            self._open()
        self._begin(initial_state)
        self._rng = rng if isinstance(rng, np.random.Generator) else rng[0]
        x, y, yaw = map(float, initial_state.pose[0])
        self._crowd.begin(initial_state, self.world)
        self._put(*self._body.frame_at(x, y, yaw), _AT_REST, ((0.0, 0.0), (0.0, 0.0)))
        self._odometry = (x, y, yaw)
        return RobotState.of_one(self._sense(), self._initial_state, self)

    def _begin(self, initial_state: InitialState, anew: bool = False) -> None:
        """Make the world and the robot those of an episode; `anew`: build them again even if they are there.

        Raises:
            InputError: If the robot is to have another radius than in its URDF file.
        """
        own, wanted = self.spec.robot.parameters, initial_state.parameters[0]
        if wanted[RADIUS] != own[RADIUS]:
            raise InputError("PyBullet takes the robot's radius from its URDF file alone")
        if anew or initial_state.world[0] != self._world_number:
            self._world_number = int(initial_state.world[0])
            self.world = self.spec.worlds[self._world_number]
            with quiet():
                clear(self._client)  # which takes half of the time of another client
                self._build()
        self._initial_state, self._exact = initial_state, is_exact(initial_state)
        self._max_speed, self._max_turn_rate = float(wanted[MAX_SPEED]), float(wanted[MAX_TURN_RATE])
        # A loaded body keeps its wheels: told other speeds, they move it as the wheels of the episode would.
        self._wheel = float(initial_state.table[0, WHEEL])
        self._turn = self._wheel * float(initial_state.table[0, ASSUMED_SEPARATION])
        self._body.weigh(*initial_state.table[0, [MASS, FRICTION]].tolist())
        strength = float(wanted[WHEEL_ACCELERATION] / own[WHEEL_ACCELERATION])
        # In each part of a step PyBullet lets a motor push for as long as in the whole step.
        self._torque = self.spec.robot.wheel_torque * strength / self.spec.substeps

    def reset_at(
        self,
        indices: np.ndarray,
        initial_state: InitialState,
        robot_state: RobotState,
        rng: Sequence[np.random.Generator] | None = None,
    ) -> tuple[RobotState, RobotState]:
        first = self.reset(initial_state, self._rng if rng is None else rng)
        return first, first

    def step(self, commands: np.ndarray, duration: float, skip: np.ndarray | None = None) -> RobotState:
        x, y = self._place
        robot_state = RobotState.of_one(self.drive(commands, duration), self._initial_state, self)
        east, north = self._place[0] - x, self._place[1] - y
        self.travelled = np.array([(east * east + north * north) ** 0.5])
        return robot_state

    def drive(self, commands: np.ndarray, duration: float) -> tuple[Any, ...]:
        """`step`, for `BulletBatch`: what the robot senses now, see `RobotState.of_one`."""
        self._driven.append((commands.copy(), duration))
        self.set_duration(duration)
        self.set_wheel_speeds(commands)
        free, at_wall = self._free_steps(duration), False
        at_mover = self.advance(free)
        for number in range(free, self._steps):  # near a wall: a touch may be shorter than a control step
            at_mover = self.advance(1, number) or at_mover
            at_wall = at_wall or self._touches_a_wall()
        return self._sense(at_wall, at_mover)

    def _free_steps(self, duration: float) -> int:
        """How many physics steps of the control step cannot take the robot to a wall, even at its top speed."""
        gap = max(self.world.clearance(*self._place) - self.spec.robot.radius - _MARGIN, 0.0)
        return int(min(gap / max(self._max_speed * self._wheel * duration, 1e-9), 1.0) * self._steps)

    def set_wheel_speeds(self, commands: np.ndarray) -> None:
        """Tell the wheel motors the speeds for `commands` (1, 2), v [m/s] and w [rad/s]."""
        robot = self.spec.robot
        v, w = commands[0].tolist()
        v = min(max(v, -self._max_speed), self._max_speed) * self._wheel
        w = min(max(w, -self._max_turn_rate), self._max_turn_rate) * self._turn
        reach = w * robot.wheel_separation / 2
        self._body.turn_wheels([speed / robot.wheel_radius for speed in (v - reach, v + reach)], self._torque)

    def advance(self, steps: int | None = None, first: int = 0) -> bool:
        """Run so many steps of the physics, None: for the duration last set; the first has number `first` in it.

        The bare stepping that `benchmark` compares `step` with.

        Returns:
            Whether something that moves has run into the robot.
        """
        steps = self._steps if steps is None else steps
        if self._crowd.dynamic_obstacles is not None:
            told = self._duration / self._steps, self._body, self._initial_state, self.world
            return self._crowd.advance(first, first + steps, self._steps, *told)
        for _ in range(steps):
            pybullet.stepSimulation(self._client)
        return False

    def state(self) -> dict[str, Any]:
        """Base and wheels of the robot, what its sensors remember, the start of the episode, and what moves."""
        position, orientation = pybullet.getBasePositionAndOrientation(self._robot, self._client)
        velocity = pybullet.getBaseVelocity(self._robot, self._client)
        wheels = tuple(joint[:2] for joint in self._joint_states())
        # PyBullet rounds what it is given, so that without this a restored robot would differ from the present one.
        self._begin(self._initial_state, anew=True)
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
            "initial_state": self._initial_state.table.copy(),
            **self._crowd.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        initial_state = InitialState(np.array(state["initial_state"]))
        self.spec.check_table(initial_state.table)
        self._begin(initial_state, anew=True)
        self._crowd.restore(state, initial_state)
        self._put(state["position"], state["orientation"], state["velocity"], state["wheels"])
        self._odometry = tuple(state["odometry"])
        robot_state = RobotState.of_one(self._sense(), initial_state, self)
        self._rng.bit_generator.state = dict(state["generator"])
        self._speed = float(state["speed"])
        self._command, self._acceleration = state["command"].copy(), float(state["acceleration"][0])
        return replace(robot_state, command=self._command, acceleration=np.array([self._acceleration]))

    def _put(self, position: Any, orientation: Any, velocity: Any, wheels: Any) -> None:
        self._put_at, self._driven = (position, orientation, velocity, wheels, self._crowd.state()), []
        self._crowd.place()
        pybullet.resetBasePositionAndOrientation(self._robot, (0.0, 0.0, 100.0), (0.0, 0.0, 0.0, 1.0), self._client)
        pybullet.performCollisionDetection(self._client)  # forgets the contacts of where it was
        pybullet.resetBasePositionAndOrientation(self._robot, position, orientation, self._client)
        pybullet.resetBaseVelocity(self._robot, *velocity, self._client)
        for wheel, (angle, rate) in zip(self._wheels, wheels, strict=True):
            pybullet.resetJointState(self._robot, wheel, angle, rate, self._client)
        self._angles = tuple(angle for angle, _ in wheels)

    def close(self) -> None:
        if self._client >= 0:
            self._disconnect()
            self._client = -1

    # ---- sensors

    def _sense(self, at_wall: bool = False, at_mover: bool = False) -> tuple[Any, ...]:
        (vx, vy, _), (_, _, turn_rate) = pybullet.getBaseVelocity(self._robot, self._client)
        x, y, yaw = pose = self._body.pose()
        self._place = x, y
        dynamic_obstacles = self._crowd.outlines
        ranges, nearest_is_dynamic = self._scanner.scan(
            pose, self.world, self._initial_state, self._rng, dynamic_obstacles
        )
        earlier, self._speed = self._speed, vx * math.cos(yaw) + vy * math.sin(yaw)
        command, duration = self._driven[-1] if self._driven else (np.zeros((1, 2)), math.inf)
        self._command, self._acceleration = command, (self._speed - earlier) / duration
        twist, bumped = (self._speed, turn_rate), at_wall or at_mover
        sensed = pose, twist, *self._count_wheels(), ranges[0], bumped, command[0], self._acceleration
        return (
            sensed
            if dynamic_obstacles is None
            else (*sensed, dynamic_obstacles[0], not at_wall and (at_mover or nearest_is_dynamic))
        )

    def _count_wheels(self) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Odometry: arcs of the wheels' encoders since the last call, added to the pose they give; and its speeds."""
        radius, joints, earlier = self.spec.robot.wheel_radius, self._joint_states(), self._angles
        self._angles = tuple(joint[0] for joint in joints)
        ways = [(joint[0] - angle) * radius for joint, angle in zip(joints, earlier, strict=True)]
        left, right = ((way, joint[1] * radius) for way, joint in zip(ways, joints, strict=True))
        initial_state = None if self._exact else self._initial_state
        self._odometry, twist = encoder_odometry(
            self._odometry, left, right, self.spec.robot.wheel_separation, initial_state
        )
        return self._odometry, twist

    def _joint_states(self) -> tuple:
        return pybullet.getJointStates(self._robot, self._wheels, self._client)

    def _touches_a_wall(self) -> bool:
        contacts = pybullet.getContactPoints(self._robot, physicsClientId=self._client)
        return any(contact[2] in self._walls and contact[8] < TOUCH for contact in contacts)  # the other one; distance

    def set_duration(self, duration: float) -> None:
        """Say how long the control steps [s] are that `advance` runs; a world that was built anew has forgotten."""
        if duration != self._duration:
            self._duration = duration
            self._steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))
            parts = {"numSubSteps": self.spec.substeps} if self.spec.substeps > 1 else {}
            pybullet.setPhysicsEngineParameter(duration / self._steps, **parts, physicsClientId=self._client)

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
        """The view of the robot's camera.

        Returns:
            Colours, shape (height, width, 3), uint8; depth along the optical axis [m], shape (height, width), float32,
            inf beyond the sensor's range.
        """
        return look_ahead(self._client, np.array(self._body.pose()), self.spec.robot.camera, width, height)

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """The view from the pose of a robot state, see `RobotState.render_camera`."""
        colours, depth = look_ahead(self._client, robot_state.pose[0], self.spec.robot.camera, width, height)
        return colours[None], depth[None]
