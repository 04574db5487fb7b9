"""Drives of hidden robots in PyBullet: the calibration drive without ROS, recorded as a bag would record it."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from calibration.robots import ROS_STEP, TICK, HiddenRobot
from deploy.ros.conftest import ros1

from tb2rl.deploy.bags.reading import Drive, read_drive
from tb2rl.deploy.bags.scans import Scans
from tb2rl.deploy.calibration_drive import CalibrationDrive
from tb2rl.deploy.portable.driver import Driver
from tb2rl.deploy.ros.messages import Twist
from tb2rl.deploy.ros.simulated_robot import SimulatedRobot
from tb2rl.envs.scene import Scene, make_scene
from tb2rl.robots.robot import find_robot
from tb2rl.simulation import find_simulator
from tb2rl.tasks.wander import Wander
from tb2rl.viz.film import FilmOptions, record
from tb2rl.worlds import World

RADIUS = 1.5  # [m] of the free disc
SIZE = (7.0, 6.0)  # [m] of the room


def room(seed: int) -> World:
    """A room with furniture along its walls."""
    rng, (x, y) = np.random.default_rng([36, seed]), SIZE
    walls = [(0.0, side * y / 2, x, 0.1, 0.0) for side in (-1, 1)] + [
        (side * x / 2, 0.0, 0.1, y, 0.0) for side in (-1, 1)
    ]
    centres = rng.uniform(-0.5, 0.5, (60, 2)) * SIZE
    centres = centres[np.hypot(*centres.T) > RADIUS + 0.6][:8]
    boxes = [(*centre, *rng.uniform(0.3, 0.8, 2).tolist(), rng.uniform(0.0, 3.1)) for centre in centres[:5].tolist()]
    posts = [(*centre, rng.uniform(0.05, 0.25)) for centre in centres[5:].tolist()]
    return World.from_shapes("room", [*walls, *boxes], posts, start=(0.0, 0.0, 0.0))


def variation(hidden: HiddenRobot) -> dict[str, float]:
    """The setting `task.variation` of a hidden robot, without its latencies."""
    names = ("wheel_radius", "wheel_separation", "acceleration", "laser_noise", "bias", "dropped", "gyro")
    mounting = ("mount_x", "mount_y", "mount_yaw")
    return {**{name: getattr(hidden, name) for name in (*names, *mounting)}, "odometry": hidden.encoders}


def hidden_scene(hidden: HiddenRobot, world: World) -> Scene:
    """The hidden robot in a world."""
    scene = make_scene(Wander(start="fixed", variation=variation(hidden)), "raw").in_worlds((world,))
    robot = replace(scene.robot, max_speed=hidden.max_speed, max_turn_rate=hidden.max_turn_rate)
    return replace(scene, spec=replace(scene.spec, robot=robot))


class Recording:
    """A hidden robot in PyBullet, which executes commands late, and whose scans arrive late; records as a bag does."""

    def __init__(self, hidden: HiddenRobot, world: World, seed: int, simulation: str = "bullet") -> None:
        self._hidden, self._commands, self._arrivals = hidden, deque(), deque()
        self.robot = SimulatedRobot(
            hidden_scene(hidden, world), find_simulator(simulation), seed, 10.0, long_ticks=False
        )
        self._ticks, self.rows = 0, {"odometry": [], "commands": [], "scans": [], "truth": []}

    @property
    def now(self) -> float:
        return self._ticks * TICK

    @property
    def is_control_step(self) -> bool:
        return self._ticks % round(0.1 / TICK) == 0

    def command(self, v: float, w: float) -> None:
        self.rows["commands"].append((self.now, v, w))
        self._commands.append((self.now + self._hidden.latency, Twist(v, w)))

    def measure(self) -> tuple[list, object]:
        """The scans that arrive now, with their stamps, and the odometry."""
        odometry, pose = self.robot.odometry(), self.robot._robot_state.pose[0].tolist()
        self.rows["odometry"].append((self.now, *odometry.pose, *odometry.twist, 0.0))
        self.rows["truth"].append((self.now, *pose, 0.0, 0.0, 0.0))
        if self._ticks % self.robot.ticks_per_scan == 0:
            self._arrivals.append((self.now, self.robot.scan()))
        arrived = []
        while self._arrivals and self._arrivals[0][0] + self._hidden.scan_age <= self.now + 1e-9:
            stamp, scan = self._arrivals.popleft()
            stamp = self.now if self._hidden.stamps_arrival else stamp
            self.rows["scans"].append((stamp, self.now - stamp, scan))
            arrived.append((stamp, scan))
        return arrived, odometry

    def step(self) -> None:
        while self._commands and self._commands[0][0] <= self.now + 1e-9:
            self.robot.command(self._commands.popleft()[1])
        self.robot.step()
        self._ticks += 1

    def follow(self, commands: Iterable[tuple[float, float]]) -> Drive:
        """Send a command in each control step, and close the simulator."""
        for v, w in commands:
            self.command(v, w)
            for _ in range(round(0.1 / TICK)):
                self.measure()
                self.step()
        self.measure()
        self.robot.close()
        return self.drive()

    def drive(self) -> Drive:
        """What `read_drive` reads from a bag of this drive."""
        times, ages, messages = zip(*self.rows["scans"], strict=True)
        first = messages[0]
        angles = first.angle_min + first.angle_increment * np.arange(len(first.ranges))
        scans = Scans(np.array(times), np.array(ages), np.array([each.ranges for each in messages], np.float32), angles)
        tables = {name: np.array(self.rows[name]) for name in ("odometry", "truth", "commands")}
        empty = np.empty((0, 3))
        return Drive("drive", {}, scan_minima=empty, bumper=empty, goals=empty, scans=scans, **tables)


def calibration_drive(hidden: HiddenRobot, seed: int, simulation: str = "bullet") -> Drive:
    """The drive of `python -m tb2rl.ros calibrate` by a hidden robot."""
    recording = Recording(hidden, room(seed), seed, simulation)
    policy = CalibrationDrive(find_robot("turtlebot2"), RADIUS)
    driver = Driver(policy)
    driver.start()
    while not policy.done and recording.now < 300.0:
        scans, odometry = recording.measure()
        for stamp, scan in scans:
            driver.see_scan(scan.to_scan(), stamp)
        driver.see_odometry(odometry.pose, odometry.twist, recording.now)
        if recording.is_control_step:
            command = driver.command(recording.now)
            recording.command(command.v, command.w)
        recording.step()
    recording.robot.close()
    assert policy.done
    assert not policy.problem
    return recording.drive()


def play_drive(hidden: HiddenRobot, seed: int) -> Drive:
    """A bag of `play --bag` of a policy with a hidden robot in PyBullet, read back; latencies are in control steps."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "robot.yaml")
        path.write_text(yaml.safe_dump(robot_tree(hidden)))
        settings = {"robot": str(path), "variation": str(path)}
        options = FilmOptions(steps=300, seed=seed, simulation="bullet")
        (bag,) = record("zoo:drive-loop-ppo", Path(folder, "drive.bag"), settings=settings, options=options)
        return read_drive(bag, {}, scans=True)


def ros_drive(hidden: HiddenRobot, seed: int, rate: float = 4.0) -> Drive:
    """A bag of `python -m tb2rl.ros calibrate` with the robot of `tb2rl.ros simulate` on ROS 1, read back."""
    with TemporaryDirectory() as name, ros1(Path(name)) as graph:
        Path(name, "robot.yaml").write_text(yaml.safe_dump(robot_tree(hidden)))
        Path(name, "room.yaml").write_text(yaml.safe_dump(shapes(room(seed))))
        settings = ["robot=robot.yaml", "variation=robot.yaml", "world=room.yaml", f"control_period={ROS_STEP}"]
        options = ["--rate", str(rate), "--seed", str(seed), "--set", *(f"task.{each}" for each in settings)]
        simulated = graph.start("simulate", *options, "--topics", "scan=/scan")
        with simulated, graph.start("calibrate", "--free", str(RADIUS)) as driven:
            assert driven.wait() == 0, driven.errors
        return read_drive(Path(name, "drive.bag"), {}, scans=True)


def shapes(world: World) -> dict[str, Any]:
    """The content of a world file."""
    boxes = [
        {"centre": [x, y], "size": [2.0 * half_length, 2.0 * half_width], "yaw": math.atan2(sin, cos)}
        for x, y, half_length, half_width, cos, sin in world.boxes.tolist()
    ]
    posts = [{"centre": [x, y], "radius": radius} for x, y, radius in world.posts.tolist()]
    return {"boxes": boxes, "posts": posts, "start": list(world.start)}


def robot_tree(hidden: HiddenRobot) -> dict[str, Any]:
    """The robot file of a hidden robot."""
    limits = {"max_speed": hidden.max_speed, "max_turn_rate": hidden.max_turn_rate}
    latencies = {"latency": hidden.latency, "observation_latency": hidden.scan_age}
    return {"robot": {"base": "turtlebot2", **limits}, "variation": variation(hidden), **latencies}
