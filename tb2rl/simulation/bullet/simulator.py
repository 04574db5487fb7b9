"""The reference physics: a robot driven by its wheels in PyBullet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.simulation.bullet.bodies import (
    add_floor,
    add_robot,
    add_walls,
    clear,
    connect,
    disconnects,
)
from tb2rl.simulation.bullet.camera import look_ahead
from tb2rl.simulation.bullet.client import pybullet, quiet
from tb2rl.simulation.bullet.obstacle_bodies import BulletObstacles
from tb2rl.simulation.bullet.scan import Scanner
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.odometry import encoder_odometry, is_exact
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.simulator import Generators
from tb2rl.simulation.spec import PHYSICS_RATE, SimulationSpec

_MARGIN = 0.02  # [m] for a robot that is faster than its command because a wall threw it back
_OF_THE_CLIENT = {"_client", "_disconnect", "_walls", "_body", "_duration", "_steps"}
_AT_REST = {"velocity": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), "wheels": ((0.0, 0.0), (0.0, 0.0))}


class BulletSimulator:
    """One robot, in one world at a time.

    Args:
        spec: The robot, its laser, and the worlds. The laser is cast exactly (`tb2rl.worlds.geometry`), not by
            PyBullet.
        window: Whether to open PyBullet's window, which needs a display.

    Raises:
        InputError: If there is no display for a window, or PyBullet cannot load the robot.
    """

    num_envs = 1

    def __init__(self, spec: SimulationSpec, window: bool = False) -> None:
        self.spec, self.laser, self._window = spec, spec.laser, window
        self._world_number, self.world = 0, spec.worlds[0]
        self._scanner = Scanner(spec.laser)
        self._rng = np.random.default_rng()
        self._obstacles = BulletObstacles(spec) if spec.has_dynamic_obstacles else None
        self._placed: tuple[dict[str, Any], dict[str, Any]] | None = None  # motion of the robot and its obstacles
        self._driven: list[tuple[np.ndarray, float]] = []  # commands and durations since then
        self._speed, self._command, self._acceleration = 0.0, np.zeros((1, 2)), 0.0  # of the last robot state
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
        """Build all of it, because the order in which bodies were made decides how contacts are rounded."""
        add_floor(self._client)
        self._walls = add_walls(self._client, self.world)
        self._body = add_robot(self._client, self.spec.robot)
        self._duration, self._steps = 0.0, 0
        if self._obstacles is not None:
            self._obstacles.connect(self._client)

    def __getstate__(self) -> dict[str, Any]:
        if self._window:
            raise InputError("an environment with PyBullet's window cannot be copied")
        return {name: value for name, value in vars(self).items() if name != "_disconnect"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Repeat the drive in a new client, because reading the state of the physics and writing it back would round.

        A drive depends on where the robot was placed and on its commands since; only in one of 300 among adjacent posts
        do the contacts of an earlier episode in this world change the last digits.
        """
        vars(self).update(state)
        if self._client < 0:
            return
        self._open()
        self._set_dynamics()
        if self._placed is not None:
            motion, obstacles = self._placed
            self._restore_obstacles(obstacles, self._initial_state)
            self._place(motion)
            for commands, duration in state["_driven"]:
                self.set_duration(duration)
                self.set_wheel_speeds(commands)
                self.advance()
        vars(self).update({name: value for name, value in state.items() if name not in _OF_THE_CLIENT})

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        if self._client < 0:  # it was closed
            self._open()
        self._begin(initial_state)
        self._rng = rng if isinstance(rng, np.random.Generator) else rng[0]
        x, y, yaw = map(float, initial_state.pose[0])
        if self._obstacles is not None:
            self._obstacles.start(initial_state, self.world)
        position, orientation = self._body.frame_at(x, y, yaw)
        self._place({"position": position, "orientation": orientation, **_AT_REST})
        self._odometry = (x, y, yaw)
        return RobotState.of_one(self._measure(), self._initial_state, self)

    def _begin(self, initial_state: InitialState, rebuild: bool = False) -> None:
        """Set up the world and the robot of an episode; `rebuild` them even if they are there.

        Raises:
            InputError: If the robot should have another radius than in its URDF file.
        """
        robot, row = self.spec.robot, initial_state.rows[0]
        if row["radius"] != robot.radius:
            raise InputError("PyBullet takes the robot's radius from its URDF file alone")
        if rebuild or initial_state.world[0] != self._world_number:
            self._world_number = int(initial_state.world[0])
            self.world = self.spec.worlds[self._world_number]
            with quiet():
                clear(self._client)  # which takes half of the time of another client
                self._build()
        self._initial_state, self._exact = initial_state, is_exact(initial_state)
        self._max_speed, self._max_turn_rate = float(row["max_speed"]), float(row["max_turn_rate"])
        # A loaded body keeps its wheels: with other speeds, they move it as the wheels of the episode would.
        self._wheel = float(row["wheel_radius"])
        self._turn = self._wheel * float(row["assumed_separation"])
        self._set_dynamics()
        strength = float(row["wheel_acceleration"] / robot.wheel_acceleration)
        # In each part of a step PyBullet lets a motor push for as long as in the whole step.
        self._torque = robot.wheel_torque * strength / self.spec.substeps

    def _set_dynamics(self) -> None:
        """Give the robot the mass and the friction of the episode."""
        row = self._initial_state.rows[0]
        self._body.set_dynamics(float(row["mass"]), float(row["friction"]))

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
        x, y = self._position
        robot_state = RobotState.of_one(self.drive(commands, duration), self._initial_state, self)
        east, north = self._position[0] - x, self._position[1] - y
        self.travelled = np.array([(east * east + north * north) ** 0.5])
        return robot_state

    def drive(self, commands: np.ndarray, duration: float) -> tuple[Any, ...]:
        """`step`, for `Share`: returns the values of `RobotState.of_one`."""
        self._driven.append((commands.copy(), duration))
        self.set_duration(duration)
        self.set_wheel_speeds(commands)
        free, at_wall = self._free_steps(duration), False
        at_obstacle = self.advance(free)
        for number in range(free, self._steps):  # near a wall: a contact may be shorter than a control step
            at_obstacle = self.advance(1, number) or at_obstacle
            at_wall = at_wall or self._body.touches(self._walls)
        return self._measure(at_wall, at_obstacle)

    def _free_steps(self, duration: float) -> int:
        """Number of physics steps of the control step in which the robot cannot reach a wall, even at top speed."""
        gap = max(self.world.clearance(*self._position) - self.spec.robot.radius - _MARGIN, 0.0)
        return int(min(gap / max(self._max_speed * self._wheel * duration, 1e-9), 1.0) * self._steps)

    def set_wheel_speeds(self, commands: np.ndarray) -> None:
        """Set the target speeds of the wheel motors for `commands` (1, 2), v [m/s] and w [rad/s]."""
        robot = self.spec.robot
        v, w = commands[0].tolist()
        v = min(max(v, -self._max_speed), self._max_speed) * self._wheel
        w = min(max(w, -self._max_turn_rate), self._max_turn_rate) * self._turn
        reach = w * robot.wheel_separation / 2
        self._body.turn_wheels([speed / robot.wheel_radius for speed in (v - reach, v + reach)], self._torque)

    def advance(self, steps: int | None = None, first: int = 0) -> bool:
        """Run steps of the physics: the bare stepping that `benchmark` compares `step` with.

        Args:
            steps: Number of them; None: those of the last `set_duration`.
            first: Number of the first one in its control step.

        Returns:
            Whether a dynamic obstacle ran into the robot.
        """
        steps = self._steps if steps is None else steps
        if self._obstacles is not None:
            now = self._duration / self._steps, self._body, self._initial_state, self.world
            return self._obstacles.run_physics(range(first, first + steps), self._steps, *now)
        for _ in range(steps):
            pybullet.stepSimulation(self._client)
        return False

    def state(self) -> dict[str, Any]:
        """Base and wheels of the robot, memory of its sensors, initial state and dynamic obstacles."""
        motion = self._body.motion()
        # PyBullet rounds what it is given, so that without this a restored robot would differ from the present one.
        self._begin(self._initial_state, rebuild=True)
        self._place(motion)
        return {
            **motion,
            "odometry": self._odometry,
            "speed": self._speed,
            "command": self._command.copy(),
            "acceleration": np.array([self._acceleration]),
            "generator": self._rng.bit_generator.state,
            "initial_state": self._initial_state.table.copy(),
            **self._obstacles_state(),
        }

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        initial_state = InitialState(np.array(state["initial_state"]))
        self.spec.check_table(initial_state.table)
        self._begin(initial_state, rebuild=True)
        self._restore_obstacles(state, initial_state)
        self._place({name: state[name] for name in ("position", "orientation", "velocity", "wheels")})
        self._odometry = tuple(state["odometry"])
        robot_state = RobotState.of_one(self._measure(), initial_state, self)
        self._rng.bit_generator.state = dict(state["generator"])
        self._speed = float(state["speed"])
        self._command, self._acceleration = state["command"].copy(), float(state["acceleration"][0])
        return replace(robot_state, command=self._command, acceleration=np.array([self._acceleration]))

    def _place(self, motion: dict[str, Any]) -> None:
        self._placed, self._driven = (motion, self._obstacles_state()), []
        if self._obstacles is not None:
            self._obstacles.place()
        self._body.teleport(**motion)
        self._angles = tuple(angle for angle, _ in motion["wheels"])

    def _obstacles_state(self) -> dict[str, Any]:
        return {} if self._obstacles is None else {"dynamic_obstacles": self._obstacles.state()}

    def _restore_obstacles(self, state: Mapping[str, Any], initial_state: InitialState) -> None:
        if self._obstacles is not None:
            self._obstacles.restore(state["dynamic_obstacles"], initial_state)

    def close(self) -> None:
        if self._client >= 0:
            self._disconnect()
            self._client = -1

    def _measure(self, at_wall: bool = False, at_obstacle: bool = False) -> tuple[Any, ...]:
        (vx, vy, _), (_, _, turn_rate) = pybullet.getBaseVelocity(self._body.body, self._client)
        x, y, yaw = pose = self._body.pose()
        self._position = x, y
        obstacles = None if self._obstacles is None else self._obstacles.arrays.obstacles
        ranges, nearest_is_dynamic = self._scanner.scan(pose, self.world, self._initial_state, self._rng, obstacles)
        earlier, self._speed = self._speed, vx * math.cos(yaw) + vy * math.sin(yaw)
        command, duration = self._driven[-1] if self._driven else (np.zeros((1, 2)), math.inf)
        self._command, self._acceleration = command, (self._speed - earlier) / duration
        twist, bumped = (self._speed, turn_rate), at_wall or at_obstacle
        measured = pose, twist, *self._read_encoders(), ranges[0], bumped, command[0], self._acceleration
        if self._obstacles is None:
            return measured
        return *measured, self._obstacles.outlines[0].copy(), not at_wall and (at_obstacle or nearest_is_dynamic)

    def _read_encoders(self) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Odometry x, y, yaw and its v and w: the arcs of the wheels since the last call, added to the last pose."""
        robot, wheels, earlier = self.spec.robot, self._body.wheel_states(), self._angles
        self._angles, radius = tuple(angle for angle, _ in wheels), robot.wheel_radius
        left, right = (((a - b) * radius, rate * radius) for (a, rate), b in zip(wheels, earlier, strict=True))
        initial_state = None if self._exact else self._initial_state
        self._odometry, twist = encoder_odometry(self._odometry, left, right, robot.wheel_separation, initial_state)
        return self._odometry, twist

    def set_duration(self, duration: float) -> None:
        """Set the duration [s] of the control steps that `advance` runs; a rebuilt world has forgotten it."""
        if duration != self._duration:
            self._duration = duration
            self._steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))
            parts = {"numSubSteps": self.spec.substeps} if self.spec.substeps > 1 else {}
            pybullet.setPhysicsEngineParameter(duration / self._steps, **parts, physicsClientId=self._client)

    def camera(self, width: int = 320, height: int = 240) -> tuple[np.ndarray, np.ndarray]:
        """Colours, shape (height, width, 3), uint8, and depth [m], (height, width), float32, of the robot's camera."""
        return look_ahead(self._client, np.array(self._body.pose()), self.spec.robot.camera, width, height)

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Images from the pose of a robot state, see `RobotState.render_camera`."""
        colours, depth = look_ahead(self._client, robot_state.pose[0], self.spec.robot.camera, width, height)
        return colours[None], depth[None]
