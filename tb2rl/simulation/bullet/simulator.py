"""The reference physics: a robot driven by its wheels in PyBullet."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.simulation.bullet.bodies import add_floor, add_robot, add_walls, camera_image, clear, connect, disconnector
from tb2rl.simulation.bullet.client import pybullet, quiet
from tb2rl.simulation.bullet.obstacle_bodies import BulletObstacles
from tb2rl.simulation.obstacles.outlines import cast_at_obstacles
from tb2rl.simulation.odometry import encoder_odometry, is_odometry_exact
from tb2rl.simulation.robot_state import ARRAYS, RobotState
from tb2rl.simulation.simulator import Generators, ResetGenerators, ResetStates
from tb2rl.simulation.spec import PHYSICS_RATE, InitialState, SimulationSpec
from tb2rl.worlds.geometry import cast_beams, limit_ranges

_MARGIN = 0.02  # [m] added to the robot's radius, because a robot that rebounds can exceed its commanded speed
_CLIENT_ATTRIBUTES = {"_client", "_disconnect", "_walls", "_body", "_duration", "_steps"}  # valid for one client only
_AT_REST = {"velocity": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), "wheels": ((0.0, 0.0), (0.0, 0.0))}


class BulletSimulator:
    """One robot in one world. The laser ranges come from the world's geometry, not from PyBullet's ray tests.

    Raises:
        InputError: If PyBullet cannot load the robot.
    """

    num_envs = 1

    def __init__(self, spec: SimulationSpec) -> None:
        self.spec = spec
        self._directions = np.cos(spec.laser.angles), np.sin(spec.laser.angles)
        self._scratch = np.empty(len(spec.laser.angles)), np.empty(len(spec.laser.angles))
        self._world_id, self.world = 0, spec.worlds[0]
        self._rng = np.random.default_rng()  # for the noise of the laser
        self._obstacles = BulletObstacles(spec)
        self._last_placement: tuple[dict[str, Any], dict[str, Any]] | None = None  # of robot and obstacles
        self._command_log: list[tuple[np.ndarray, float]] = []  # commands and durations since the last placement
        self._speed, self._command, self._acceleration = 0.0, np.zeros(2), 0.0  # those of the last robot state
        self._open()
        self._prepare(InitialState.default(spec, 1))

    def _open(self) -> None:
        """Build the world and the robot in a new PyBullet client."""
        with quiet():
            self._client = connect()
            self._disconnect = disconnector(self, self._client)
            try:
                self._build()
            except InputError:
                self.close()
                raise

    def _build(self) -> None:
        """Build all bodies in an empty client, because rounding errors of contacts depend on the order of creation."""
        add_floor(self._client)
        self._walls = add_walls(self._client, self.world)
        self._body = add_robot(self._client, self.spec.robot)
        self._duration, self._steps = 0.0, 0
        self._obstacles.connect(self._client)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_disconnect"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Repeat the drive in a new client, because the state of the physics cannot be copied without rounding errors.

        Among adjacent posts, 1 of 300 copies differs in the last digits, because it lacks earlier episodes' contacts.
        """
        vars(self).update(state)
        if self._client < 0:
            return
        self._open()
        self._prepare(self._initial_state)
        if self._last_placement is not None:
            motion, obstacles = self._last_placement
            self._obstacles.restore(obstacles, self._initial_state)
            self._place(motion)
            for command, duration in state["_command_log"]:
                self.set_duration(duration)
                self.set_wheel_speeds(command.tolist())
                self.advance()
        vars(self).update({name: value for name, value in state.items() if name not in _CLIENT_ATTRIBUTES})

    def reset(self, initial_state: InitialState, rng: Generators) -> RobotState:
        generator = rng if isinstance(rng, np.random.Generator) else rng[0]
        return RobotState.for_one_robot(self.reset_values(initial_state, generator), initial_state, self)

    def reset_values(self, initial_state: InitialState, rng: np.random.Generator | None) -> tuple[Any, ...]:
        """Start an episode like `reset`, but return plain values, which `BulletBatch` writes to shared memory.

        Args:
            initial_state: One row.
            rng: Generator for the noise of the laser; None: the present generator.

        Returns:
            Values for `RobotState.for_one_robot`.
        """
        if self._client < 0:  # the simulator was closed
            self._open()
        self._prepare(initial_state)
        self._rng = rng or self._rng
        x, y, yaw = map(float, initial_state.pose[0])
        self._obstacles.reset_at(np.zeros(1, int), initial_state)
        position, orientation = self._body.frame_at(x, y, yaw)
        self._place({"position": position, "orientation": orientation, **_AT_REST})
        self._odometry = (x, y, yaw)
        return self._measure()

    def _prepare(self, initial_state: InitialState, rebuild: bool = False) -> None:
        """Set up world and robot of an episode; with `rebuild`, build the bodies again even in the same world."""
        robot, row = self.spec.robot, initial_state.records[0]
        if row["radius"] != robot.radius:
            raise InputError("PyBullet cannot change the robot's radius; use another simulator")
        if rebuild or row["world"] != self._world_id:
            self._world_id = int(row["world"])
            self.world = self.spec.worlds[self._world_id]
            with quiet():
                clear(self._client)  # takes half as long as opening another client
                self._build()
        self._initial_state, self._has_exact_odometry = initial_state, is_odometry_exact(initial_state.records)
        self._max_speed, self._max_turn_rate = float(row["max_speed"]), float(row["max_turn_rate"])
        # PyBullet cannot resize the wheels of a loaded body. Scaled commands move the robot as other wheels would.
        self._v_scale = float(row["wheel_radius"])
        self._w_scale = self._v_scale * float(row["assumed_separation"])
        self._body.set_dynamics(float(row["mass"]), float(row["friction"]))
        self._laser_mount = float(row["mount_x"]), float(row["mount_y"]), float(row["mount_yaw"])
        noise = self.spec.laser.noise if row["laser_noise"] < 0.0 else float(row["laser_noise"])
        self._laser_errors = noise, float(row["bias"]), float(row["dropped"])
        acceleration = float(row["wheel_acceleration"] / robot.wheel_acceleration)  # true / nominal
        # Divided by the substeps, because PyBullet applies the impulse of a whole step in each of them.
        self._torque = robot.wheel_torque * acceleration / self.spec.substeps

    def reset_at(self, indices: np.ndarray, initial_state: InitialState, rng: ResetGenerators = None) -> ResetStates:
        robot_state = self.reset(initial_state, rng or self._rng)
        return robot_state, robot_state

    def step(self, commands: np.ndarray, duration: float, inactive: np.ndarray | None = None) -> RobotState:
        x, y = self._position
        values = self.step_values(commands[0].tolist(), duration)
        robot_state = RobotState.for_one_robot(values, self._initial_state, self)
        dx, dy = self._position[0] - x, self._position[1] - y
        self.travelled = np.array([(dx * dx + dy * dy) ** 0.5])
        return robot_state

    def step_values(self, command: Sequence[float], duration: float) -> tuple[Any, ...]:
        """Drive with a command v, w; returns the values of the robot state, see `reset_values`."""
        self._command_log.append((np.array(command), duration))
        self.set_duration(duration)
        self.set_wheel_speeds(command)
        gap = max(self.world.clearance(*self._position) - self.spec.robot.radius - _MARGIN, 0.0)
        contact_free_share = min(gap / max(self._max_speed * self._v_scale * duration, 1e-9), 1.0)
        return self._measure(*self.advance(int(contact_free_share * self._steps)))

    def set_duration(self, duration: float) -> None:
        """Set the duration [s] of the control steps that `advance` runs; each `_build` resets it."""
        if duration != self._duration:
            self._duration = duration
            self._steps = max(1, math.ceil(duration * PHYSICS_RATE - 1e-9))
            substeps = {"numSubSteps": self.spec.substeps} if self.spec.substeps > 1 else {}
            pybullet.setPhysicsEngineParameter(duration / self._steps, **substeps, physicsClientId=self._client)

    def set_wheel_speeds(self, command: Sequence[float]) -> None:
        """Set the target speeds of the wheel motors for a command, v [m/s] and w [rad/s]."""
        robot, (v, w) = self.spec.robot, command
        v = min(max(v, -self._max_speed), self._max_speed) * self._v_scale
        w = min(max(w, -self._max_turn_rate), self._max_turn_rate) * self._w_scale
        turn_speed = w * robot.wheel_separation / 2
        rates = [speed / robot.wheel_radius for speed in (v - turn_speed, v + turn_speed)]
        self._body.set_wheel_rates(rates, self._torque)

    def advance(self, contact_free_steps: float = math.inf) -> tuple[bool, bool]:
        """Run the physics steps of a control step.

        Args:
            contact_free_steps: Number of physics steps in which the robot cannot reach a wall, even at top speed. All
                later ones (inf: none) are checked for contacts, which may be shorter than a control step.

        Returns:
            Whether the robot touched a wall, and whether it touched a dynamic obstacle.
        """
        wall_hit, obstacles, client, steps = False, self._obstacles, self._client, self._steps
        obstacles_done = obstacles.begin_step(steps, self._duration / steps, self._body, self._initial_state)
        for step in range(steps):
            if obstacles_done:
                pybullet.stepSimulation(client)
            else:
                obstacles.step(step)
            if step >= contact_free_steps and not wall_hit:
                wall_hit = self._body.touches(self._walls)
        return wall_hit, obstacles.touched

    def state(self) -> dict[str, Any]:
        """Motion and sensors of the robot, initial state and dynamic obstacles."""
        motion = self._body.motion()
        # PyBullet rounds a restored motion. Restoring it here, too, lets this simulator go on from the same numbers.
        self._prepare(self._initial_state, rebuild=True)
        self._place(motion)
        return {
            **motion,
            "odometry": self._odometry,
            "speed": self._speed,
            "acceleration": np.array([self._acceleration]),
            "command": self._command.copy(),
            "initial_state": self._initial_state.table.copy(),
            "generator": self._rng.bit_generator.state,
            "dynamic_obstacles": self._obstacles.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> RobotState:
        return RobotState.for_one_robot(self.restore_values(state), self._initial_state, self)

    def restore_values(self, state: Mapping[str, Any]) -> tuple[Any, ...]:
        """Restore a state; returns the values of the robot state, see `reset_values`."""
        initial_state = InitialState(np.array(state["initial_state"]))
        self.spec.check_table(initial_state.table)
        self._prepare(initial_state, rebuild=True)
        self._obstacles.restore(state["dynamic_obstacles"], initial_state)
        self._place({name: state[name] for name in ("position", "orientation", "velocity", "wheels")})
        self._odometry = tuple(state["odometry"])
        measured = list(self._measure())
        self._rng.bit_generator.state = dict(state["generator"])
        self._speed = float(state["speed"])
        self._command, self._acceleration = state["command"].copy(), float(state["acceleration"][0])
        measured[ARRAYS.index("command")], measured[ARRAYS.index("acceleration")] = self._command, self._acceleration
        return tuple(measured)

    def _place(self, motion: dict[str, Any]) -> None:
        """Place the robot and the dynamic obstacles; `motion` is a result of `RobotBody.motion`."""
        self._last_placement, self._command_log = (motion, self._obstacles.state()), []
        self._obstacles.place()
        self._body.teleport(**motion)
        self._angles, self._yaw = tuple(angle for angle, _ in motion["wheels"]), self._body.pose()[2]

    def close(self) -> None:
        if self._client >= 0:
            self._disconnect()
            self._client = -1

    def _measure(self, wall_hit: bool = False, obstacle_hit: bool = False) -> tuple[Any, ...]:
        """Update position, odometry, speed, command, acceleration; return values for `RobotState.for_one_robot`."""
        (vx, vy, _), (_, _, turn_rate) = pybullet.getBaseVelocity(self._body.body, self._client)
        x, y, yaw = pose = self._body.pose()
        self._position = x, y
        ranges, nearest_is_dynamic = self._scan(*pose)
        last_speed, self._speed = self._speed, vx * math.cos(yaw) + vy * math.sin(yaw)
        self._command, duration = self._command_log[-1] if self._command_log else (np.zeros(2), math.inf)
        self._acceleration = (self._speed - last_speed) / duration  # 0 without a command: the duration is inf
        twist, bumped = (self._speed, turn_rate), wall_hit or obstacle_hit
        odometry = self._update_odometry(yaw, turn_rate)
        measured = pose, twist, *odometry, ranges[0], bumped, self._command, self._acceleration
        if not self.spec.has_dynamic_obstacles:
            return measured
        return *measured, self._obstacles.outlines[0].copy(), not wall_hit and (obstacle_hit or nearest_is_dynamic)

    def _scan(self, x: float, y: float, yaw: float) -> tuple[np.ndarray, bool]:
        """Ranges [m], shape (1, beams), and whether the nearest obstacle is a dynamic one."""
        laser, ranges = self.spec.laser, np.empty((1, len(self._directions[0])))
        (mount_x, mount_y, mount_yaw), (noise, bias, dropped) = self._laser_mount, self._laser_errors
        if mount_x or mount_y:
            cos, sin = math.cos(yaw), math.sin(yaw)
            x, y = x + mount_x * cos - mount_y * sin, y + mount_x * sin + mount_y * cos
        pose, is_dynamic = (x, y, yaw + mount_yaw), False
        cast_beams(pose, self._directions, self.world.spatial_index, 0, self._scratch, ranges, 0)
        if self.spec.has_dynamic_obstacles:
            is_dynamic = cast_at_obstacles(*pose, self._directions, self._obstacles.arrays.obstacles, 0, ranges)
        if noise:
            ranges += noise * self._rng.standard_normal(ranges.shape)
        if bias:
            ranges += bias
        limit_ranges(ranges, 0, laser.min_range, laser.max_range)
        if dropped:
            ranges[self._rng.random(ranges.shape) < dropped] = np.inf
        return ranges, is_dynamic

    def _update_odometry(self, yaw: float, turn_rate: float) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Update the odometry by the motion since the last call; return x, y, yaw, and v, w."""
        robot, wheels = self.spec.robot, self._body.wheel_states()
        turns = [(angle - last, rate) for (angle, rate), last in zip(wheels, self._angles, strict=True)]
        left, right = ((turn * robot.wheel_radius, rate * robot.wheel_radius) for turn, rate in turns)
        turned = (yaw - self._yaw, turn_rate) if robot.gyro else None
        self._angles, self._yaw = tuple(angle for angle, _ in wheels), yaw
        motion = left, right, turned, robot.wheel_separation
        initial_state = None if self._has_exact_odometry else self._initial_state
        self._odometry, twist = encoder_odometry(self._odometry, *motion, initial_state)
        return self._odometry, twist

    def camera(self, width: int = 320, height: int = 240) -> tuple[np.ndarray, np.ndarray]:
        """Colours, shape (height, width, 3), uint8, and depth [m], (height, width), float32, of the robot's camera."""
        return camera_image(self._client, np.array(self._body.pose()), self.spec.robot.camera, width, height)

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Images from the pose of a robot state, see `RobotState.render_camera`."""
        colours, depth = camera_image(self._client, robot_state.pose[0], self.spec.robot.camera, width, height)
        return colours[None], depth[None]
