"""What `python -m tb2rl.ros simulate` does: a simulated robot on a graph of ROS, with the services of Gazebo."""

from __future__ import annotations

import argparse
import math
import signal
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress

from tb2rl.core.errors import InputError
from tb2rl.deploy.portable.ending import ending_signals
from tb2rl.deploy.ros.graph import EMPTY, SET_PHYSICS, Graph, Nobody, join
from tb2rl.deploy.ros.messages import Bump, Clock, Image, Odometry, Scan, Transforms, Velocity
from tb2rl.deploy.ros.simulator import Simulator
from tb2rl.deploy.ros.topics import Topics, parse_topics
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.simulation import default_simulator, find_simulator

SCAN_RATES = (2.0, 40.0)  # [Hz] a base that is commanded more seldom stops in between
_LATE = 0.1  # [s] of wall-clock time: what was lost beyond is not made up for
_BREATH = 1e-4  # [s] so that the threads of ROS get to say something while time runs as fast as it can
_AGAIN = 5.0  # [s] of wall-clock time until the scan is said again that nobody has answered yet, and maybe nobody heard
_LOOK_UP = 0.2  # [s] of wall-clock time between looks whether anybody is there
_ALONE = 1.0  # [s] of wall-clock time after which who hears scans, and sends no commands, waits for a scan


def run(options: argparse.Namespace) -> None:
    """Simulate until a signal ends it, then say how far it came."""
    check(options)
    topics, name = parse_topics(options.topics, Topics()), find_simulator(options.simulation or default_simulator())
    config = resolve("random", options.task, settings={"task.start": "fixed"} | parse_settings(options.set))
    with closing(join(options.ros, "tb2rl_simulation")) as graph:
        for ending in ending_signals():
            signal.signal(ending, signal.default_int_handler)
        simulator = Simulator(config.scene, name, options.seed, options.scan_rate, coarse=options.lockstep is not None)
        with closing(Server(simulator, graph, topics, options.rate, options.lockstep)) as server:
            print(f"simulating {config.task_name} in {config.scene.place} ({name.name}) on ROS {options.ros}", flush=True)
            with suppress(KeyboardInterrupt):
                server.run()


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` for a number that does not fit."""
    if not 0.0 <= options.rate < math.inf:
        raise InputError(f"--rate must be a number from 0 (as fast as possible), got {options.rate:g}")
    if not SCAN_RATES[0] <= options.scan_rate <= SCAN_RATES[1]:
        raise InputError(
            f"--scan-rate must be from {SCAN_RATES[0]:g} to {SCAN_RATES[1]:g} Hz, got {options.scan_rate:g}"
        )
    if options.lockstep is not None and not 0.0 < options.lockstep < threading.TIMEOUT_MAX:
        raise InputError(f"--lockstep takes seconds above 0, got {options.lockstep:g}")
    if options.seed < 0:
        raise InputError(f"--seed must be at least 0, got {options.seed}")


class Server:
    """A simulator on a graph: says what it senses, hears commands, keeps its time.

    Args:
        simulator: What is simulated.
        graph: Where.
        topics: By which names.
        rate: Simulated seconds in one of wall-clock time; 0: as many as can be.
        lockstep: Wait after each scan for the command that answers it, so many seconds of wall-clock time at most; and
            for somebody to be there first. None: time does not wait.
    """

    def __init__(self, simulator: Simulator, graph: Graph, topics: Topics, rate: float, lockstep: float | None) -> None:
        self._simulator, self._graph, self._rate, self._lockstep = simulator, graph, rate, lockstep
        self._turn = threading.Condition()  # whose it is: ours, or that of a thread of ROS
        self._paused = self._resumed = self._answered = self._disturbed = self._commanded = False
        self._until_scan, self._unanswered, self._due, self._scan_due = 0, 0, 0.0, 0.0
        self._clock, self._tf = graph.publisher("/clock", Clock), graph.publisher("/tf", Transforms)
        self._scan, self._odometry = graph.publisher(topics.scan, Scan), graph.publisher(topics.odometry, Odometry)
        self._depth, self._bumper = graph.publisher(topics.depth, Image), graph.publisher(topics.bumper, Bump)
        self._colours = graph.publisher(topics.colours, Image) if simulator.has_colours else Nobody()
        self._commands = [graph.listen(topic, Velocity, self._drive) for topic in (topics.velocity, topics.navigation)]
        services: dict[str, Callable[[], None]] = {
            "pause_physics": lambda: self._pause(True),
            "unpause_physics": lambda: self._pause(False),
            "reset_world": lambda: self._reset(clock=False),
            "reset_simulation": lambda: self._reset(clock=True),
        }
        for service, called in services.items():
            graph.serve(f"/gazebo/{service}", EMPTY, called)
        graph.serve("/gazebo/set_physics_properties", SET_PHYSICS, lambda: None)  # programs wait for it alone
        graph.keep_time()

    def run(self) -> None:
        """Let time pass until ROS ends the node."""
        while not self._graph.is_over():
            with self._turn:
                if not self._paused and self._somebody_is_there():
                    self._pass_a_tick()
                    pause = self._pause_until_due()
                else:
                    if not self._paused:
                        self._stand_still()
                    self._turn.wait(_LOOK_UP)
                    pause, self._due = 0.0, time.monotonic()
            time.sleep(pause)

    def close(self) -> None:
        """Say how it went since the last reset, and how it went with the lockstep."""
        self._tell()
        if self._lockstep is not None:
            print(f"scans that no command answered: {self._unanswered}", flush=True)

    def _somebody_is_there(self) -> bool:
        if self._lockstep is None:
            return True
        return self._scan.connected() and any(each.connected() for each in self._commands)

    def _pass_a_tick(self) -> None:
        self._answered &= self._resumed  # a command since the end of a pause answers the scan that came before it
        self._resumed = self._disturbed = False
        self._say(with_scan=self._until_scan == 0)
        if self._until_scan == 0:
            if self._lockstep is not None and not self._is_answered(self._lockstep):
                return
            self._until_scan = self._simulator.ticks_per_scan
        self._until_scan -= 1
        for bump in self._simulator.advance():
            self._bumper.say(bump)

    def _stand_still(self) -> None:
        """Publish the present instant again while nobody drives: programs may wait for it before they send a command.

        Scans come later and less often, because each program that joins would answer them.
        """
        now = time.monotonic()
        if not self._scan.connected():
            self._scan_due = now + _ALONE
        with_scan = now >= self._scan_due
        if with_scan:
            self._scan_due = now + _ALONE
        self._say(with_scan)

    def _is_answered(self, seconds: float) -> bool:
        """Wait for an answer to the scan; False: the scan must be said again."""
        said = time.monotonic()
        until = said + seconds
        while not (self._answered or self._disturbed):
            now = time.monotonic()
            if now >= until:
                self._unanswered += 1
                return True
            if not self._commanded and now > said + _AGAIN:  # who has only just joined can miss one
                self._say(with_scan=True)
                said = now
            self._turn.wait(min(until - now, _LOOK_UP))
            if self._graph.is_over() or not self._somebody_is_there():
                return False
        return not self._disturbed

    def _say(self, with_scan: bool) -> None:
        """Publish what the sensors say at this tick; the clock first, for who waits until a stamp has come."""
        simulator = self._simulator
        self._clock.say(simulator.clock())
        self._tf.say(simulator.transforms())
        self._odometry.say(simulator.odometry())
        if with_scan:
            self._show()
            self._scan.say(simulator.scan())

    def _show(self) -> None:
        """Publish images, if anybody looks: they take longer than all else."""
        if self._colours.connected() or self._depth.connected():
            colours, depth = self._simulator.images()
            self._depth.say(depth)
            if colours is not None:
                self._colours.say(colours)

    def _pause_until_due(self) -> float:
        """How long to sleep so that ticks come at the rate that was asked for [s]."""
        if self._rate == 0.0:
            return 0.0 if self._lockstep is not None else _BREATH
        now = time.monotonic()
        self._due = max(self._due, now - _LATE) + self._simulator.tick / self._rate
        return max(self._due - now, _BREATH)

    # ---- what the threads of ROS call

    def _drive(self, velocity: Velocity) -> None:
        with self._turn:
            self._simulator.drive(velocity)
            self._answered = self._commanded = True
            self._turn.notify_all()

    def _pause(self, paused: bool) -> None:
        with self._turn:
            if self._paused and not paused:
                self._resumed, self._answered = True, False
            self._paused = self._disturbed = paused
            self._turn.notify_all()

    def _reset(self, clock: bool) -> None:
        with self._turn:
            self._tell()
            self._simulator.put_back(clock)
            self._until_scan, self._disturbed = 0, True
            self._turn.notify_all()

    def _tell(self) -> None:
        if self._simulator.record.seconds > 0.0:
            print(self._simulator.record, flush=True)
