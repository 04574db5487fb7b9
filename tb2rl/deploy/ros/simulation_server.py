"""Publishes a simulated robot to ROS, with the services of Gazebo."""

from __future__ import annotations

import argparse
import math
import signal
import threading
from contextlib import closing, suppress
from typing import Annotated

from annotated_types import Ge, Le, Lt

from tb2rl.core.values import CountOrZero, NonNegative, Positive, checked
from tb2rl.deploy.portable.termination import termination_signals
from tb2rl.deploy.ros.connection import create_node
from tb2rl.deploy.ros.messages import BumperEvent, Clock, Image, LaserScan, Odometry, Transforms, Twist
from tb2rl.deploy.ros.node import EMPTY, SET_PHYSICS, Node, NullPublisher
from tb2rl.deploy.ros.simulated_robot import SimulatedRobot
from tb2rl.deploy.ros.topics import Topics, parse_topics
from tb2rl.deploy.ros.wall_clock import WallClock
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.simulation import default_simulator, find_simulator

SCAN_RATE = Annotated[float, Ge(2.0), Le(40.0)]  # [Hz] with fewer the base's timeout would expire between commands
# All in seconds of wall-clock time:
_MAX_DELAY = 0.1  # a longer delay is not made up for
_YIELD = 1e-4  # gives the threads of ROS a chance to run in a simulation at full speed
_REPEAT = 5.0  # after which a scan that no program has answered yet is published again
_POLL = 0.2  # between two checks whether programs are connected
_STANDSTILL_SCAN = 1.0  # between scans while no program sends commands


def run(options: argparse.Namespace) -> None:
    """Simulate until a signal ends the program."""
    check(options)
    topics = parse_topics(options.topics, Topics())
    simulator = find_simulator(options.simulation or default_simulator())
    config = resolve("random", options.task, settings={"task.start": "fixed"} | parse_settings(options.set))
    with closing(create_node(options.ros, "tb2rl_simulation")) as node:
        for ending in termination_signals():
            signal.signal(ending, signal.default_int_handler)
        coarse = options.lockstep is not None
        with closing(SimulatedRobot(config.scene, simulator, options.seed, options.scan_rate, coarse)) as robot:
            server = SimulationServer(robot, node, topics, options.rate, options.lockstep)
            print(
                f"simulating {config.task_name} in {config.scene.place} ({simulator.name}) on ROS {options.ros}",
                flush=True,
            )
            with closing(server), suppress(KeyboardInterrupt):
                server.run()


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` for a number out of range."""
    checked(Annotated[NonNegative, Lt(math.inf)], options.rate, "--rate")
    checked(SCAN_RATE, options.scan_rate, "--scan-rate")
    checked(Annotated[Positive, Lt(threading.TIMEOUT_MAX)] | None, options.lockstep, "--lockstep")
    checked(CountOrZero, options.seed, "--seed")


class SimulationServer:
    """Publishes the sensors and the clock of a robot, and executes commands.

    Args:
        rate: Simulated seconds per second of wall-clock time; 0: as fast as possible.
        lockstep: Wait for connected programs and, after each scan, for the command that answers it, so many seconds of
            wall-clock time at most. None: the simulation does not wait.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        node: Node,
        topics: Topics,
        rate: float,
        lockstep: float | None,
        wall: WallClock | None = None,
    ) -> None:
        self._robot, self._node, self._rate, self._lockstep = robot, node, rate, lockstep
        self._wall = wall or WallClock()
        self._lock = threading.Condition()  # shared with the threads of ROS
        self._paused = self._resumed = self._answered = self._interrupted = self._commanded = False
        self._ticks_until_scan, self._unanswered, self._due, self._scan_due = 0, 0, 0.0, 0.0
        self._clock, self._tf = node.create_publisher("/clock", Clock), node.create_publisher("/tf", Transforms)
        self._scan = node.create_publisher(topics.scan, LaserScan)
        self._odometry = node.create_publisher(topics.odometry, Odometry)
        self._depth = node.create_publisher(topics.depth, Image)
        self._colours = node.create_publisher(topics.colours, Image) if robot.has_colours else NullPublisher()
        self._bumper = node.create_publisher(topics.bumper, BumperEvent)
        self._commands = [
            node.create_subscription(topic, Twist, self._command) for topic in (topics.velocity, topics.navigation)
        ]
        node.create_service("/gazebo/pause_physics", EMPTY, lambda: self._pause(True))
        node.create_service("/gazebo/unpause_physics", EMPTY, lambda: self._pause(False))
        node.create_service("/gazebo/reset_world", EMPTY, lambda: self._reset(clock=False))
        node.create_service("/gazebo/reset_simulation", EMPTY, lambda: self._reset(clock=True))
        node.create_service("/gazebo/set_physics_properties", SET_PHYSICS, lambda: None)  # programs only wait for it
        node.announce_sim_time()

    def run(self) -> None:
        """Simulate until ROS ends the node."""
        while not self._node.is_shutdown():
            with self._lock:
                if not self._paused and self._programs_connected():
                    self._step()
                    pause = self._seconds_until_due()
                else:
                    if not self._paused:
                        self._publish_standstill()
                    self._wall.wait(self._lock, _POLL)
                    pause, self._due = 0.0, self._wall.now()
            self._wall.sleep(pause)

    def close(self) -> None:
        """Print the record since the last reset, and how many scans no command answered."""
        self._print_record()
        if self._lockstep is not None:
            print(f"scans that no command answered: {self._unanswered}", flush=True)

    def _programs_connected(self) -> bool:
        if self._lockstep is None:
            return True
        return self._scan.connected() and any(each.connected() for each in self._commands)

    def _step(self) -> None:
        self._answered &= self._resumed  # a command right after a pause answers the scan before the pause
        self._resumed = self._interrupted = False
        self._publish(with_scan=self._ticks_until_scan == 0)
        if self._ticks_until_scan == 0:
            if self._lockstep is not None and not self._wait_for_answer(self._lockstep):
                return
            self._ticks_until_scan = self._robot.ticks_per_scan
        self._ticks_until_scan -= 1
        for event in self._robot.step():
            self._bumper.publish(event)

    def _publish_standstill(self) -> None:
        """Publish the present instant again, because programs may wait for sensors before they send a command.

        Scans are rarer, because each program that joins would answer them.
        """
        now = self._wall.now()
        if not self._scan.connected():
            self._scan_due = now + _STANDSTILL_SCAN
        with_scan = now >= self._scan_due
        if with_scan:
            self._scan_due = now + _STANDSTILL_SCAN
        self._publish(with_scan)

    def _wait_for_answer(self, seconds: float) -> bool:
        """Wait for the command that answers the scan; False: the scan must be published again."""
        published = self._wall.now()
        deadline = published + seconds
        while not (self._answered or self._interrupted):
            now = self._wall.now()
            if now >= deadline:
                self._unanswered += 1
                return True
            if not self._commanded and now > published + _REPEAT:  # a program that has just joined can miss a scan
                self._publish(with_scan=True)
                published = now
            self._wall.wait(self._lock, min(deadline - now, _POLL))
            if self._node.is_shutdown() or not self._programs_connected():
                return False
        return not self._interrupted

    def _publish(self, with_scan: bool) -> None:
        """Publish sensors; the clock first, for programs that wait until it reaches a stamp."""
        self._clock.publish(self._robot.clock())
        self._tf.publish(self._robot.transforms())
        self._odometry.publish(self._robot.odometry())
        if with_scan:
            if self._colours.connected() or self._depth.connected():  # images take longer than all else
                colours, depth = self._robot.images()
                self._depth.publish(depth)
                if colours is not None:
                    self._colours.publish(colours)
            self._scan.publish(self._robot.scan())

    def _seconds_until_due(self) -> float:
        """Return the wall-clock time until the next tick at the requested rate [s]."""
        if self._rate == 0.0:
            return 0.0 if self._lockstep is not None else _YIELD
        now = self._wall.now()
        self._due = max(self._due, now - _MAX_DELAY) + self._robot.tick / self._rate
        return max(self._due - now, _YIELD)

    # ---- called by the threads of ROS

    def _command(self, velocity: Twist) -> None:
        with self._lock:
            self._robot.command(velocity)
            self._answered = self._commanded = True
            self._lock.notify_all()

    def _pause(self, paused: bool) -> None:
        with self._lock:
            if self._paused and not paused:
                self._resumed, self._answered = True, False
            self._paused = self._interrupted = paused
            self._lock.notify_all()

    def _reset(self, clock: bool) -> None:
        with self._lock:
            self._print_record()
            self._robot.reset(clock)
            self._ticks_until_scan, self._interrupted = 0, True
            self._lock.notify_all()

    def _print_record(self) -> None:
        if self._robot.record.seconds > 0.0:
            print(self._robot.record, flush=True)
