"""A simulated robot that executes its last command until a timeout, as a real robot does; independent of ROS."""

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from tb2rl.deploy.ros import messages as msg
from tb2rl.deploy.ros.events import BumperEvent, bumper_events
from tb2rl.envs.scene import Scene
from tb2rl.sensors.motion import bumper_at
from tb2rl.simulation import RobotState, SimulatorType
from tb2rl.simulation.random_streams import GeneratorSource

COMMAND_TIMEOUT = 600_000_000  # [ns] after which the base stops without a new command, as kobuki_node does
MAX_TICK = 0.025  # [s] two steps of the physics
ODOM, BASE, LASER, CAMERA = "odom", "base_footprint", "laser_link", "camera_rgb_optical_frame"
LASER_HEIGHT = 0.25  # [m] of the scan plane
IMAGE_WIDTH, IMAGE_HEIGHT = 320, 240  # [px]
_CAMERA_ROTATION = -0.5, 0.5, -0.5, 0.5  # quaternion; x right, y down, z ahead (REP 103)
_MAX_CONTACT_DISTANCE = 0.05  # [m] from the hull; if all readings are farther, the contact is behind the robot
_TICKS_BETWEEN_READS = 20_000  # of the simulator's state


@dataclass
class DriveRecord:
    """Statistics of a drive since the last reset."""

    start: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    seconds: float = 0.0  # simulated time
    distance: float = 0.0  # [m]
    contact_count: int = 0
    min_range: float = math.inf  # [m]

    def add_tick(self, before: RobotState, after: RobotState, seconds: float) -> None:
        """Add a tick, from the robot states before and after it."""
        self.seconds += seconds
        self.distance += float(np.hypot(*(after.pose - before.pose)[0, :2]))
        self.contact_count += bool(after.bumped[0]) and not before.bumped[0]
        self.min_range = min(self.min_range, float(after.nearest_range[0]))

    def __str__(self) -> str:
        start = "({:.2f}, {:.2f}, {:.2f})".format(*self.start)
        contacts = f"touched something {self.contact_count} times, nearest range {self.min_range:.2f} m"
        return f"from {start}: {self.seconds:.1f} s, {self.distance:.1f} m, {contacts}"


class SimulatedRobot:
    """A robot in the worlds of a scene, simulated tick by tick. Not thread-safe.

    Its laser has all beams, even if the task uses only some of them. With latencies in the task's variation, commands
    take effect later, and scans and odometry are published later, with the time of their measurement.

    The `scan_rate` is in Hz. With `long_ticks` a tick lasts from scan to scan, for programs that send one command per
    scan. The `seed` is that of random starts and laser noise.
    """

    def __init__(self, scene: Scene, simulation: SimulatorType, seed: int, scan_rate: float, long_ticks: bool) -> None:
        laser = replace(scene.robot.laser, noise=scene.task.laser_noise)
        self._spec, self._task, self.has_colours = replace(scene.spec, laser=laser), scene.task, simulation.has_colours
        self.ticks_per_scan = 1 if long_ticks else math.ceil(1.0 / (scan_rate * MAX_TICK) - 1e-9)
        self._tick_ns = round(msg.BILLION / (scan_rate * self.ticks_per_scan))
        self.tick_duration = self._tick_ns / msg.BILLION  # [s]
        self._rng, self._time_ns = np.random.default_rng(seed), 0
        self._bumper: int | None = None  # pressed according to the last event, also across resets
        self._simulator = simulation.open(self._spec)
        self.reset()

    def reset(self, reset_clock: bool = False) -> None:
        """Move the robot to an initial state of the task, at rest; `reset_clock`: set the time back to 0, too."""
        initial_state = self._task.randomized_initial_state(self._spec, GeneratorSource(self._rng))
        self._robot_state = self._simulator.reset(initial_state, self._rng)
        self._time_ns = 0 if reset_clock else self._time_ns
        period, records = self._task.control_period * msg.BILLION, initial_state.records
        self._command_latency = round(float(records["command_latency"][0]) * period)  # [ns]
        self._sensor_latency = round(float(records["observation_latency"][0]) * period)  # [ns]
        self._measured = deque([(self._time_ns, self._robot_state)])  # times [ns] and states, the published one first
        self._command, self._command_time = np.zeros((1, 2)), self._time_ns
        self._late_commands: deque[tuple[int, np.ndarray]] = deque()  # with the times when they take effect [ns]
        self.record = DriveRecord(initial_state.pose[0].tolist())

    def command(self, velocity: msg.Twist) -> None:
        """Execute a command until the next one or the timeout."""
        command = np.array([[velocity.linear, velocity.angular]])
        self._late_commands.append((self._time_ns + self._command_latency, command))

    def step(self) -> list[BumperEvent]:
        """Simulate one tick; returns the bumper events."""
        while self._late_commands and self._late_commands[0][0] <= self._time_ns:
            self._command_time, self._command = self._late_commands.popleft()
        command = self._command if self._time_ns - self._command_time < COMMAND_TIMEOUT else np.zeros((1, 2))
        before, self._robot_state = self._robot_state, self._simulator.step(command, self.tick_duration)
        self._time_ns += self._tick_ns
        self._measured.append((self._time_ns, self._robot_state))
        while len(self._measured) > 1 and self._measured[1][0] <= self._time_ns - self._sensor_latency:
            self._measured.popleft()
        if self._time_ns // self._tick_ns % _TICKS_BETWEEN_READS == 0:
            self._simulator.state()  # because PyBullet's simulator stores all commands since the last read
        self.record.add_tick(before, self._robot_state, self.tick_duration)
        last_bumper, self._bumper = self._bumper, self._pressed_bumper(self._robot_state)
        return bumper_events(last_bumper, self._bumper)

    def close(self) -> None:
        self._simulator.close()

    # ---- messages of the current sensor data

    def clock(self) -> msg.Clock:
        return msg.Clock(self._time_ns)

    def scan(self) -> msg.LaserScan:
        period = self._tick_ns * self.ticks_per_scan / msg.BILLION
        stamp, robot_state = self._measured[0]
        return msg.LaserScan.of(self._spec.laser, stamp, LASER, period, robot_state.ranges[0])

    def odometry(self) -> msg.Odometry:
        """Wheel odometry; it counts from the start pose in the world, so that its frame is the world's frame."""
        stamp, robot_state = self._measured[0]
        pose, twist = robot_state.odometry[0].tolist(), robot_state.odometry_twist[0].tolist()
        return msg.Odometry(stamp, ODOM, BASE, pose, twist)

    def transforms(self) -> msg.Transforms:
        """Pose of the robot by its odometry, and poses of the laser and the camera on the robot."""
        stamp, robot_state = self._measured[0]
        x, y, yaw = robot_state.odometry[0].tolist()
        base = msg.Transform(stamp, ODOM, BASE, (x, y, 0.0), msg.quaternion(yaw))
        laser = msg.Transform(self._time_ns, BASE, LASER, (0.0, 0.0, LASER_HEIGHT), msg.quaternion(0.0))
        camera = msg.Transform(self._time_ns, BASE, CAMERA, self._spec.robot.camera.position, _CAMERA_ROTATION)
        return msg.Transforms((base, laser, camera))

    def images(self) -> tuple[msg.Image | None, msg.Image]:
        """Camera images: RGB, or None if the simulator has no colours, and depth."""
        colours, depth = self._robot_state.render_camera(IMAGE_WIDTH, IMAGE_HEIGHT)
        rgb = None if colours is None else msg.Image(self._time_ns, CAMERA, colours[0])
        return rgb, msg.Image(self._time_ns, CAMERA, depth[0])

    def _pressed_bumper(self, robot_state: RobotState) -> int | None:
        beam = int(np.argmin(robot_state.ranges[0]))
        if not robot_state.bumped[0] or robot_state.ranges[0, beam] > self._spec.robot.radius + _MAX_CONTACT_DISTANCE:
            return None
        return bumper_at(self._spec.laser.angles[beam])
