"""A simulated robot that drives at the last command it heard, as a real one does; it knows no ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tb2rl.deploy.ros.messages import (
    BILLION,
    Bump,
    Clock,
    Image,
    Odometry,
    Scan,
    Transform,
    Transforms,
    Velocity,
    upright,
)
from tb2rl.envs.scene import Scene
from tb2rl.robots import Laser, Robot
from tb2rl.sensors.bumper import bumper_at
from tb2rl.simulation import RobotState, SimulatorType
from tb2rl.simulation.random_streams import GeneratorDraws

COMMAND_TIMEOUT = 600_000_000  # [ns] kobuki_node: a base that hears nothing for so long stops
FINEST = 0.025  # [s] two steps of the physics: commands are obeyed, and odometry is told, this often
ODOM, BASE, LASER, CAMERA = "odom", "base_footprint", "laser_link", "camera_rgb_optical_frame"
LASER_HEIGHT = 0.25  # [m] where worlds are cut for the laser
WIDTH, HEIGHT = 320, 240  # [px] of the camera's images
_OPTICAL = -0.5, 0.5, -0.5, 0.5  # x right, y down, z ahead (REP 103)
_AT_THE_HULL = 0.05  # [m] a touch from behind presses no bumper, and nothing is this near ahead
_FORGETTING = 20_000  # ticks


@dataclass
class Record:
    """What a robot did since it was put at its start pose."""

    start: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    seconds: float = 0.0  # of simulated time
    distance: float = 0.0  # [m]
    touches: int = 0  # how often it ran into something
    nearest: float = math.inf  # [m] shortest range

    def note(self, before: RobotState, after: RobotState, seconds: float) -> None:
        """Take in one tick."""
        self.seconds += seconds
        self.distance += float(np.hypot(*(after.pose - before.pose)[0, :2]))
        self.touches += bool(after.bumped[0]) and not before.bumped[0]
        self.nearest = min(self.nearest, float(after.nearest[0]))

    def __str__(self) -> str:
        x, y, yaw = self.start
        return (
            f"from ({x:.2f}, {y:.2f}, {yaw:.2f}): {self.seconds:.1f} s, {self.distance:.1f} m, "
            f"touched something {self.touches} times, nearest range {self.nearest:.2f} m"
        )


class Simulator:
    """One robot in the worlds of a scene, from tick to tick. Not for several threads at once.

    It has its robot's whole laser, whichever beams the scene's task reads, and obeys at once, also where the task's
    variation has latencies: ROS has its own.

    Args:
        scene: The robot, its worlds, and where it starts.
        simulation: The type of simulator.
        seed: Of the starts and of the laser's noise.
        scan_rate: How often the laser sweeps [Hz].
        coarse: Let a tick be as long as a sweep: for who commands the robot no more often.
    """

    def __init__(self, scene: Scene, simulation: SimulatorType, seed: int, scan_rate: float, coarse: bool) -> None:
        laser = replace(scene.robot.laser, noise=scene.task.laser_noise)
        self._spec, self._task = replace(scene.spec, laser=laser), scene.task
        self.has_colours = simulation.has_colours
        self.ticks_per_scan = 1 if coarse else math.ceil(1.0 / (scan_rate * FINEST) - 1e-9)
        self._tick = round(BILLION / (scan_rate * self.ticks_per_scan))  # [ns]
        self._rng, self._ticks, self._time = np.random.default_rng(seed), 0, 0
        self._simulation = simulation.open(self._spec)
        self.put_back()

    @property
    def tick(self) -> float:
        """How long a tick is [s]."""
        return self._tick / BILLION

    def put_back(self, clock: bool = False) -> None:
        """Begin again at a start of the task, at rest; `clock`: and at time 0."""
        initial_state = self._task.randomized_initial_state(self._spec, GeneratorDraws(self._rng))
        self._reading = self._simulation.reset(initial_state, self._rng)
        self._time = 0 if clock else self._time
        self._command, self._told = np.zeros((1, 2)), self._time
        x, y, yaw = initial_state.pose[0].tolist()
        self.record = Record((x, y, yaw))

    def drive(self, velocity: Velocity) -> None:
        """Obey a command, until another comes or none for too long."""
        self._command, self._told = np.array([[velocity.linear, velocity.angular]]), self._time

    def advance(self) -> list[Bump]:
        """Let a tick pass: what the bumpers have to say about it."""
        obeyed = self._command if self._time - self._told < COMMAND_TIMEOUT else np.zeros((1, 2))
        before, self._reading = self._reading, self._simulation.step(obeyed, self.tick)
        self._time += self._tick
        self._ticks += 1
        if self._ticks % _FORGETTING == 0:
            self._simulation.state()  # PyBullet's side remembers the way here until its state is taken
        self.record.note(before, self._reading, self.tick)
        return self._bumps(before)

    def close(self) -> None:
        """Free what the simulation holds."""
        self._simulation.close()

    # ---- what the sensors say now

    def clock(self) -> Clock:
        return Clock(self._time)

    def scan(self) -> Scan:
        laser, period = self._spec.laser, self._tick * self.ticks_per_scan / BILLION
        return Scan(
            self._time, LASER, *_sweep(laser), period, laser.min_range, laser.max_range, self._reading.ranges[0]
        )

    def odometry(self) -> Odometry:
        """In the world's frame: it begins at the start pose, and counts the wheels from there."""
        x, y, yaw = self._reading.odometry[0].tolist()
        v, w = self._reading.odometry_twist[0].tolist()
        return Odometry(self._time, ODOM, BASE, (x, y, yaw), (v, w))

    def transforms(self) -> Transforms:
        """Where the robot is by its odometry, and where laser and camera are on it."""
        x, y, yaw = self._reading.odometry[0].tolist()
        base = Transform(ODOM, BASE, (x, y, 0.0), upright(yaw))
        return Transforms(self._time, (base, *_mounts(self._spec.robot)))

    def images(self) -> tuple[Image | None, Image]:
        """What the camera sees, in colours (PyBullet alone has them) and as depths."""
        colours, depth = self._reading.render_camera(WIDTH, HEIGHT)
        coloured = None if colours is None else Image(self._time, CAMERA, colours[0])
        return coloured, Image(self._time, CAMERA, depth[0])

    def _bumps(self, before: RobotState) -> list[Bump]:
        """What was pressed or let go in a tick."""
        was, now = self._bumper(before), self._bumper(self._reading)
        if was == now:
            return []
        told = [] if was is None else [Bump(was, False)]
        return told if now is None else [*told, Bump(now, True)]

    def _bumper(self, robot_state: RobotState) -> int | None:
        """Which of the bumpers is pressed."""
        beam = int(np.argmin(robot_state.ranges[0]))
        if not robot_state.bumped[0] or robot_state.ranges[0, beam] > self._spec.robot.radius + _AT_THE_HULL:
            return None
        return bumper_at(self._spec.laser.angles[beam])


def _sweep(laser: Laser) -> tuple[float, float]:
    """The angle of the first beam, and from each to the next [rad]."""
    angles = laser.angles
    return float(angles[0]), float(angles[-1] - angles[0]) / max(1, len(angles) - 1)


def _mounts(robot: Robot) -> tuple[Transform, Transform]:
    return (
        Transform(BASE, LASER, (0.0, 0.0, LASER_HEIGHT), upright(0.0)),
        Transform(BASE, CAMERA, robot.camera.position, _OPTICAL),
    )
