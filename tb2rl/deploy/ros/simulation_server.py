"""Connects a simulated robot to ROS, with the services of Gazebo."""

import argparse
import math
import signal
import threading
from contextlib import closing, suppress
from functools import partial
from typing import Annotated

from annotated_types import Ge, Le, Lt

from tb2rl.core.values import CountOrZero, NonNegative, Positive, checked
from tb2rl.deploy.portable.termination import termination_signals
from tb2rl.deploy.ros import create_node
from tb2rl.deploy.ros.events import EVENTS, create_event_publisher
from tb2rl.deploy.ros.messages import Clock, Image, LaserScan, Odometry, Transforms, Twist
from tb2rl.deploy.ros.node import ABSENT, EMPTY, SET_PHYSICS, TRIGGER, Node, WallClock
from tb2rl.deploy.ros.simulated_robot import SimulatedRobot
from tb2rl.deploy.ros.topics import SIMULATED, Topics, parse_topics
from tb2rl.runs.config import parse_settings, resolve
from tb2rl.simulation.simulator import default_simulator, find_simulator

ScanRate = Annotated[float, Ge(2.0), Le(40.0)]  # [Hz] at a lower rate the base would time out between commands
# All in seconds of wall-clock time:
_MAX_DELAY = 0.1  # of a tick; later ticks do not make up for a longer delay
_MIN_SLEEP = 1e-4  # between ticks at full speed, so that the threads of ROS can run
_SCAN_REPEAT_PERIOD = 5.0  # of an unanswered scan, before the first command
_POLL_PERIOD = 0.2  # of the checks whether programs are connected
_STANDSTILL_SCAN_PERIOD = 1.0  # while the simulation waits for programs to connect


def run(options: argparse.Namespace) -> None:
    """Simulate until a signal ends the program."""
    checked(Annotated[NonNegative, Lt(math.inf)], options.rate, "--rate")
    checked(ScanRate, options.scan_rate, "--scan-rate")
    checked(Annotated[Positive, Lt(threading.TIMEOUT_MAX)] | None, options.lockstep, "--lockstep")
    checked(CountOrZero, options.seed, "--seed")
    topics = parse_topics(options.topics, SIMULATED[options.ros])
    simulator = find_simulator(options.simulation or default_simulator())
    config = resolve(agent="random", task=options.task, settings={"task.start": "fixed"} | parse_settings(options.set))
    with closing(create_node(options.ros, "tb2rl_simulation")) as node:
        for termination_signal in termination_signals():
            signal.signal(termination_signal, signal.default_int_handler)
        long_ticks = options.lockstep is not None
        with closing(SimulatedRobot(config.scene, simulator, options.seed, options.scan_rate, long_ticks)) as robot:
            server = SimulationServer(robot, node, topics, options.rate, options.lockstep)
            simulation = f"{config.task_name} in {config.scene.worlds_title} ({simulator.name})"
            print(f"simulating {simulation} on ROS {options.ros}", flush=True)
            with closing(server), suppress(KeyboardInterrupt):
                server.run()


class SimulationServer:
    """Publishes the sensors and the clock of a robot, and executes commands.

    Args:
        rate: Simulated seconds per second of wall-clock time; 0: as fast as possible.
        lockstep: Timeout of the answer to a scan [s] of wall-clock time; None: no lockstep. In lockstep the simulation
            waits for programs to connect and, after each scan, for a command.
    """

    def __init__(self, robot: SimulatedRobot, node: Node, topics: Topics, rate: float, lockstep: float | None) -> None:
        self._robot, self._node, self._rate, self._lockstep, self._clock = robot, node, rate, lockstep, WallClock()
        self._condition = threading.Condition()  # its lock is shared with the threads of ROS
        self._is_paused = self._has_resumed = self._has_answer = self._is_interrupted = self._had_command = False
        self._ticks_until_scan, self._unanswered_scans = 0, 0
        self._next_tick_time, self._next_standstill_scan_time = 0.0, 0.0  # [s] of wall-clock time
        self._sim_clock, self._tf = node.create_publisher("/clock", Clock), node.create_publisher("/tf", Transforms)
        self._scan = node.create_publisher(topics.scan, LaserScan)
        self._odometry = node.create_publisher(topics.odometry, Odometry)
        self._depth = node.create_publisher(topics.depth, Image)
        self._colours = node.create_publisher(topics.colours, Image) if robot.has_colours else ABSENT
        self._publish_events = {name: create_event_publisher(node, topics, name) for name in EVENTS}
        self._active_events = set[str]()
        inputs = topics.velocity, topics.navigation
        self._commands = [node.create_subscription(topic, Twist, self._on_command) for topic in inputs]
        for name in EVENTS.keys() - {"bumper"}:  # bumpers are pressed by walls
            node.create_service(f"~/{name}", TRIGGER, partial(self._toggle_event, name))
        node.create_service("/gazebo/pause_physics", EMPTY, lambda: self._set_paused(True))
        node.create_service("/gazebo/unpause_physics", EMPTY, lambda: self._set_paused(False))
        node.create_service("/gazebo/reset_world", EMPTY, lambda: self._reset(reset_clock=False))
        node.create_service("/gazebo/reset_simulation", EMPTY, lambda: self._reset(reset_clock=True))
        node.create_service("/gazebo/set_physics_properties", SET_PHYSICS, lambda: None)  # programs need no effect
        node.announce_sim_time()

    def run(self) -> None:
        """Simulate until ROS shuts the node down."""
        while not self._node.is_shutdown():
            with self._condition:
                if not self._is_paused and self._programs_connected():
                    self._step()
                    sleep_time = self._seconds_until_next_tick()
                else:
                    if not self._is_paused:
                        self._publish_standstill()
                    self._clock.wait(self._condition, _POLL_PERIOD)
                    sleep_time, self._next_tick_time = 0.0, self._clock.now()
            self._clock.sleep(sleep_time)

    def close(self) -> None:
        """Print the record since the last reset and, in lockstep, the number of scans without an answer."""
        self._print_record()
        if self._lockstep is not None:
            print(f"scans that no command answered: {self._unanswered_scans}", flush=True)

    def _toggle_event(self, name: str) -> str:
        """Begin an event of the base, or end it if it has begun."""
        self._active_events ^= {name}
        self._publish_events[name](EVENTS[name](0, name in self._active_events))
        return ""

    def _programs_connected(self) -> bool:
        return self._lockstep is None or (self._scan.connected() and any(each.connected() for each in self._commands))

    def _step(self) -> None:
        self._has_answer &= self._has_resumed  # a command before the scan is its answer only after a pause
        self._has_resumed = self._is_interrupted = False
        self._publish(with_scan=self._ticks_until_scan == 0)
        if self._ticks_until_scan == 0:
            if self._lockstep is not None and not self._wait_for_answer(self._lockstep):
                return
            self._ticks_until_scan = self._robot.ticks_per_scan
        self._ticks_until_scan -= 1
        for event in self._robot.step():
            self._publish_events["bumper"](event)

    def _publish_standstill(self) -> None:
        """Publish the current sensors again, because a program may wait for them before it connects a publisher.

        Scans are published less often, because programs answer them.
        """
        now, connected = self._clock.now(), self._scan.connected()
        with_scan = connected and now >= self._next_standstill_scan_time
        if with_scan or not connected:
            self._next_standstill_scan_time = now + _STANDSTILL_SCAN_PERIOD
        self._publish(with_scan)

    def _wait_for_answer(self, timeout: float) -> bool:
        """Wait for the command that answers the scan; returns False if the scan must be published again."""
        publish_time = self._clock.now()
        deadline = publish_time + timeout
        while not (self._has_answer or self._is_interrupted):
            now = self._clock.now()
            if now >= deadline:
                self._unanswered_scans += 1
                return True
            if not self._had_command and now > publish_time + _SCAN_REPEAT_PERIOD:  # a new program can miss a scan
                self._publish(with_scan=True)
                publish_time = now
            self._clock.wait(self._condition, min(deadline - now, _POLL_PERIOD))
            if self._node.is_shutdown() or not self._programs_connected():
                return False
        return not self._is_interrupted

    def _publish(self, with_scan: bool) -> None:
        """Publish the sensors, and before them the clock, because programs may wait until it reaches a stamp."""
        self._sim_clock.publish(self._robot.clock())
        self._tf.publish(self._robot.transforms())
        self._odometry.publish(self._robot.odometry())
        if with_scan:
            if self._colours.connected() or self._depth.connected():  # because images are slow
                colours, depth = self._robot.images()
                self._depth.publish(depth)
                if colours is not None:
                    self._colours.publish(colours)
            self._scan.publish(self._robot.scan())

    def _seconds_until_next_tick(self) -> float:
        """Return the wall-clock time until the next tick at the requested rate [s]."""
        if self._rate == 0.0:
            return 0.0 if self._lockstep is not None else _MIN_SLEEP
        now = self._clock.now()
        self._next_tick_time = max(self._next_tick_time, now - _MAX_DELAY) + self._robot.tick_duration / self._rate
        return max(self._next_tick_time - now, _MIN_SLEEP)

    # ---- called by the threads of ROS

    def _on_command(self, velocity: Twist) -> None:
        with self._condition:
            self._robot.command(velocity)
            self._has_answer = self._had_command = True
            self._condition.notify_all()

    def _set_paused(self, paused: bool) -> None:
        with self._condition:
            if self._is_paused and not paused:
                self._has_resumed, self._has_answer = True, False
            self._is_paused = self._is_interrupted = paused
            self._condition.notify_all()

    def _reset(self, reset_clock: bool) -> None:
        with self._condition:
            self._print_record()
            self._robot.reset(reset_clock)
            self._ticks_until_scan, self._is_interrupted = 0, True
            self._condition.notify_all()

    def _print_record(self) -> None:
        if self._robot.record.seconds > 0.0:
            print(self._robot.record, flush=True)
