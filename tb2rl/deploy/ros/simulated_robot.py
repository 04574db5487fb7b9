"""A simulated robot that executes the last command it received, as a real one does; independent of ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tb2rl.deploy.ros import messages as msg
from tb2rl.envs.scene import Scene
from tb2rl.sensors.bumper import bumper_at
from tb2rl.simulation import RobotState, SimulatorType
from tb2rl.simulation.random_streams import GeneratorDraws

COMMAND_TIMEOUT = 600_000_000  # [ns] kobuki_node: the base stops after so long without a command
FINEST = 0.025  # [s] longest tick, two steps of the physics: period of commands and odometry
ODOM, BASE, LASER, CAMERA = "odom", "base_footprint", "laser_link", "camera_rgb_optical_frame"
LASER_HEIGHT = 0.25  # [m] where worlds are cut for the laser
WIDTH, HEIGHT = 320, 240  # [px] of the camera's images
_OPTICAL = -0.5, 0.5, -0.5, 0.5  # x right, y down, z ahead (REP 103)
_CONTACT_RANGE = 0.05  # [m] beyond the hull: a contact without a range below it is one from behind
_TRIMMED = 20_000  # ticks between two reads of the simulator's state


@dataclass
class DriveRecord:
    """Statistics of a drive since the last reset."""

    start: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    seconds: float = 0.0  # of simulated time
    distance: float = 0.0  # [m]
    contacts: int = 0
    nearest: float = math.inf  # [m] shortest range

    def add(self, before: RobotState, after: RobotState, seconds: float) -> None:
        """Add one tick."""
        self.seconds += seconds
        self.distance += float(np.hypot(*(after.pose - before.pose)[0, :2]))
        self.contacts += bool(after.bumped[0]) and not before.bumped[0]
        self.nearest = min(self.nearest, float(after.nearest[0]))

    def __str__(self) -> str:
        x, y, yaw = self.start
        return (
            f"from ({x:.2f}, {y:.2f}, {yaw:.2f}): {self.seconds:.1f} s, {self.distance:.1f} m, "
            f"touched something {self.contacts} times, nearest range {self.nearest:.2f} m"
        )


class SimulatedRobot:
    """One robot in the worlds of a scene, simulated tick by tick. Not thread-safe.

    It has all beams of the robot's laser, whichever the task uses. It ignores the latencies of the task's variation,
    because ROS has its own.

    Args:
        scene: The robot, its worlds and its initial state.
        simulation: The type of simulator.
        seed: Seed of random starts and laser noise.
        scan_rate: Scans per second [Hz].
        coarse: Whether a tick lasts from scan to scan, for programs that send one command per scan.
    """

    def __init__(self, scene: Scene, simulation: SimulatorType, seed: int, scan_rate: float, coarse: bool) -> None:
        laser = replace(scene.robot.laser, noise=scene.task.laser_noise)
        self._spec, self._task = replace(scene.spec, laser=laser), scene.task
        self.has_colours = simulation.has_colours
        self.ticks_per_scan = 1 if coarse else math.ceil(1.0 / (scan_rate * FINEST) - 1e-9)
        self._tick = round(msg.BILLION / (scan_rate * self.ticks_per_scan))  # [ns]
        self._rng, self._ticks, self._time = np.random.default_rng(seed), 0, 0
        self._simulator = simulation.open(self._spec)
        self.reset()

    @property
    def tick(self) -> float:
        """Duration of a tick [s]."""
        return self._tick / msg.BILLION

    def reset(self, clock: bool = False) -> None:
        """Put the robot to an initial state of the task, at rest; `clock`: set the time back to 0, too."""
        initial_state = self._task.randomized_initial_state(self._spec, GeneratorDraws(self._rng))
        self._robot_state = self._simulator.reset(initial_state, self._rng)
        self._time = 0 if clock else self._time
        self.command(msg.Twist(0.0, 0.0))
        x, y, yaw = initial_state.pose[0].tolist()
        self.record = DriveRecord((x, y, yaw))

    def command(self, velocity: msg.Twist) -> None:
        """Execute a command until the next one or the timeout."""
        self._command, self._command_time = np.array([[velocity.linear, velocity.angular]]), self._time

    def step(self) -> list[msg.BumperEvent]:
        """Simulate one tick; return its bumper events."""
        command = self._command if self._time - self._command_time < COMMAND_TIMEOUT else np.zeros((1, 2))
        before, self._robot_state = self._robot_state, self._simulator.step(command, self.tick)
        self._time += self._tick
        self._ticks += 1
        if self._ticks % _TRIMMED == 0:
            self._simulator.state()  # because PyBullet's simulator stores all commands since the last read
        self.record.add(before, self._robot_state, self.tick)
        return msg.bumper_events(self._pressed_bumper(before), self._pressed_bumper(self._robot_state))

    def close(self) -> None:
        """Free the simulator."""
        self._simulator.close()

    # ---- sensor messages of this instant

    def clock(self) -> msg.Clock:
        return msg.Clock(self._time)

    def scan(self) -> msg.LaserScan:
        laser, period = self._spec.laser, self._tick * self.ticks_per_scan / msg.BILLION
        angle_min, angle_max = float(laser.angles[0]), float(laser.angles[-1])
        increment = (angle_max - angle_min) / max(1, len(laser.angles) - 1)
        ranges = self._robot_state.ranges[0]
        return msg.LaserScan(self._time, LASER, angle_min, increment, period, laser.min_range, laser.max_range, ranges)

    def odometry(self) -> msg.Odometry:
        """Wheel odometry in the world's frame: it begins at the start pose."""
        x, y, yaw = self._robot_state.odometry[0].tolist()
        v, w = self._robot_state.odometry_twist[0].tolist()
        return msg.Odometry(self._time, ODOM, BASE, (x, y, yaw), (v, w))

    def transforms(self) -> msg.Transforms:
        """Pose of the robot by its odometry, and poses of laser and camera on it."""
        x, y, yaw = self._robot_state.odometry[0].tolist()
        base = msg.Transform(ODOM, BASE, (x, y, 0.0), msg.quaternion(yaw))
        laser = msg.Transform(BASE, LASER, (0.0, 0.0, LASER_HEIGHT), msg.quaternion(0.0))
        camera = msg.Transform(BASE, CAMERA, self._spec.robot.camera.position, _OPTICAL)
        return msg.Transforms(self._time, (base, laser, camera))

    def images(self) -> tuple[msg.Image | None, msg.Image]:
        """Camera images: colours, None if the simulator has none, and depths."""
        colours, depth = self._robot_state.render_camera(WIDTH, HEIGHT)
        coloured = None if colours is None else msg.Image(self._time, CAMERA, colours[0])
        return coloured, msg.Image(self._time, CAMERA, depth[0])

    def _pressed_bumper(self, robot_state: RobotState) -> int | None:
        beam = int(np.argmin(robot_state.ranges[0]))
        if not robot_state.bumped[0] or robot_state.ranges[0, beam] > self._spec.robot.radius + _CONTACT_RANGE:
            return None
        return bumper_at(self._spec.laser.angles[beam])
