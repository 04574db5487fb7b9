"""A robot of a graph of ROS in the place of a simulation: time passes by itself, and odometry says where it is."""

from __future__ import annotations

import atexit
import math
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.deploy import Limits, Mounting, Needs, ScanReader
from tb2rl.deploy import Scan as Turn
from tb2rl.deploy.portable.driver import stale
from tb2rl.deploy.portable.preflight import STALE
from tb2rl.deploy.portable.scan import Seen
from tb2rl.deploy.ros.graph import EMPTY, Graph
from tb2rl.deploy.ros.messages import BILLION, Bump, Odometry, Scan, Velocity
from tb2rl.deploy.ros.topics import DriverTopics
from tb2rl.simulation import InitialState, RobotState, SimulationSpec

RESETS = ("/gazebo/reset_world", "/reset_world")  # services of Gazebo that put a robot back, in ROS 1 and in ROS 2
PUT_BACK = "put the robot where the episode is to begin, then press Enter: "
_STILL = (0.0, 0.0)
_SLOW = (0.02, 0.05)  # [m/s], [rad/s] what is slower stands
_EARLY, _LATE = 0.1, 0.5  # shares of a control step: a scan may end it so early, and be missing for so long at its end
_LOOK_UP = 0.02  # [s] of wall-clock time between looks
_AGAIN = 0.2  # [s] of wall-clock time after which the wheels are told the same again: a base forgets after 0.6 s
_LOST = 2.0  # [s] the same in a simulation, which may take a word for the answer to a scan that is under way
_STOPS = 10  # times that the wheels are told to stand; then somebody else may drive the robot
_LEFT = 0.5  # [s] of wall-clock time without another step after which the robot is told to stand
_PATIENCE = 10.0  # [s] of wall-clock time for sensors to begin, and for a simulation's clock that stands still
_ROLLING = 3.0  # [s] of wall-clock time until a robot stands
_SETTLED = 2  # scans that come after a robot was put back, before one counts: others may be under way
_ANOTHER = 1e6  # [s] between two clocks of which one counts from the beginning of a simulation


class RemoteRobot:
    """See `tb2rl.simulation.Simulation`. A step ends with the scan that comes when its time is over, on average.

    An episode begins at the start that it is given, and odometry counts on from there: there is no other truth. What
    Gazebo does not put back, the user does, if a terminal can ask for it; else the robot goes on from where it is.

    The robot is told to stand at a touch, where scans or odometry are missing or no step follows for half a second,
    between episodes, and at the end.

    Args:
        spec: The robot, its laser, and the world that its episodes count in.
        needs: What its policy needs to see.
        graph: Where it is; `close` leaves it.
        topics: By which names.
        mounting: Where its scanner is.
        limits: What it is to do at most; what is faster is slowed down on the same arc.
    """

    num_envs = 1

    def __init__(
        self, spec: SimulationSpec, needs: Needs, graph: Graph, topics: DriverTopics, mounting: Mounting, limits: Limits
    ) -> None:
        self.spec, self._graph, self._topics, self._limits = spec, graph, topics, limits
        self._reader = ScanReader(needs, mounting)
        self._simulated = graph.time_is_simulated()
        self._turn = threading.Condition(threading.RLock())  # whose it is: ours, or that of a thread of ROS
        self._scan: Scan | None = None  # the last, which nobody has looked at
        self._came = self._heard = -math.inf  # when, by the graph's clock and by the one on the wall
        self._seen, self._seen_count = Seen(np.empty(0), np.empty(0)), 0  # of those that show what the policy needs
        self._seen_at = self._seen_heard = -math.inf
        self._lacks = ""  # what is wrong with the last one
        self._odometry = Odometry(0, "", "", (0.0, 0.0, 0.0), _STILL)
        self._counted_at = self._counted_heard = -math.inf
        self._touched = self._pressed = False
        self._told, self._stops, self._said = _STILL, 0, -math.inf  # when, by the clock on the wall
        self._until = -math.inf  # to when the wheels are told the same; then a scan ends the step that is under way
        self._left = math.inf  # when the robot counts as left alone, by the clock on the wall
        self._velocity = graph.publisher(topics.velocity, Velocity)
        graph.listen(topics.scan, Scan, self._see_scan)
        graph.listen(topics.odometry, Odometry, self._see_odometry)
        graph.listen(topics.bumper, Bump, self._feel)
        self._over = threading.Event()
        self._watch = threading.Thread(target=self._keep_telling, daemon=True)
        self._watch.start()
        atexit.register(self.close)

    def reset(self, initial_state: InitialState, rng: np.random.Generator) -> RobotState:
        """See `tb2rl.simulation.Simulation`.

        Raises:
            InputError: If nothing is heard of the robot, or it was left.
        """
        if self._over.is_set():
            raise InputError("the robot was left when its environment was closed: make another one")
        self._stand(lambda: True)
        self._put_back()
        before, until = self._seen_count, time.monotonic() + _ROLLING
        self._stand(lambda: self._seen_count >= before + _SETTLED)
        self._stand(lambda: self._stands() or time.monotonic() > until)
        with self._turn:
            self._initial_state, self._origin, self._speed = initial_state, self._odometry.pose, 0.0
            self._touched, self._due = False, -math.inf
            return self._reading(math.inf)

    def step(self, commands: np.ndarray, duration: float) -> RobotState:
        """See `tb2rl.simulation.Simulation`.

        Raises:
            InputError: If scans or odometry are missing for half a second.
        """
        with self._turn:
            self._look()
            before, now = self._seen_count, self._graph.now()
            if abs(now - self._due) > duration:  # it begins, was left alone, or its clock was set back
                self._due = now
            self._due += duration
            late, self._until = self._due + _LATE * duration, self._due - _EARLY * duration
            self._left = math.inf
            self._tell(self._limits.slowed(*commands[0].tolist()))

            def is_shown() -> bool:  # or the clock was set back
                return self._seen_count > before and not now - duration < self._seen_at < self._until

            try:
                self._wait(lambda: is_shown() or self._graph.now() > late, STALE)
                if self._simulated:  # odometry of the same instant may come after the scan
                    self._turn.wait_for(lambda: self._counted_at >= self._seen_at, _LOOK_UP)
            except BaseException:
                self._tell(_STILL)
                raise
            finally:
                self._until, self._left = -math.inf, time.monotonic() + _LEFT
            return self._reading(duration)

    def __reduce__(self) -> NoReturn:
        raise InputError("there is one robot with ROS: it cannot be copied")

    def state(self) -> NoReturn:
        """Not of a robot.

        Raises:
            InputError: Always.
        """
        raise InputError("a robot with ROS cannot be put back into a state")

    def restore(self, state: Mapping[str, Any]) -> NoReturn:
        """See `state`."""
        self.state()

    def render_camera(self, robot_state: RobotState, width: int, height: int) -> NoReturn:
        """Not by ROS.

        Raises:
            InputError: Always.
        """
        raise InputError("a robot with ROS hands over no images here")

    def close(self) -> None:
        """Tell the wheels to stand, and leave the graph."""
        if self._over.is_set():
            return
        atexit.unregister(self.close)
        self._over.set()
        self._watch.join()
        for _ in range(_STOPS):
            with self._turn:
                self._tell(_STILL)
            time.sleep(_LOOK_UP)  # the last words shall be heard
        self._graph.close()

    # ---- what the threads of ROS call

    def _see_scan(self, scan: Scan) -> None:
        with self._turn:
            self._scan, self._heard = scan, time.monotonic()
            # The clock of a simulation comes on a topic of its own, maybe after the scan of the same instant.
            self._came = scan.stamp / BILLION if self._simulated else self._graph.now()
            if self._came < self._until:
                self._say()  # simulations may wait for an answer to each scan
            self._turn.notify_all()

    def _see_odometry(self, odometry: Odometry) -> None:
        if odometry.is_usable:  # else it is as good as none
            with self._turn:
                self._odometry, self._counted_heard = odometry, time.monotonic()
                self._counted_at = odometry.stamp / BILLION if self._simulated else self._graph.now()
                self._turn.notify_all()

    def _feel(self, bump: Bump) -> None:
        with self._turn:
            self._pressed = bump.pressed
            if bump.pressed:
                self._touched = True
                self._tell(_STILL)

    # ---- what they and our own threads do in turns

    def _keep_telling(self) -> None:
        again = _LOST if self._simulated else 0.0
        while not self._over.wait(_AGAIN):
            with self._turn:
                if time.monotonic() > self._left and self._told != _STILL:
                    self._tell(_STILL)
                elif time.monotonic() > self._said + again and (self._stops or self._until > -math.inf):
                    self._say()

    def _tell(self, speeds: tuple[float, float]) -> None:
        self._told, self._stops = speeds, _STOPS if speeds == _STILL else 0
        self._say()

    def _say(self) -> None:
        self._stops, self._said = max(0, self._stops - 1), time.monotonic()
        self._velocity.say(Velocity(*self._told))

    def _stand(self, enough: Callable[[], bool]) -> None:
        """See `_wait`: and stand so long, which is said again and again, for a simulation may wait for it."""
        with self._turn:
            self._until = math.inf
            self._tell(_STILL)
            try:
                self._wait(enough)
            finally:
                self._until = -math.inf

    def _wait(self, enough: Callable[[], bool], oldest: float = math.inf) -> None:
        """Until there is odometry and a scan that shows what the policy needs, and it is enough.

        Args:
            enough: Says so.
            oldest: How old both may become [s]; they must come within ten seconds of wall-clock time anyway.

        Raises:
            InputError: If one of them is missing.
        """
        with self._turn:
            began = time.monotonic()
            while not (self._look() and self._counted_at > -math.inf and enough()):
                missing = self._missing(began, oldest)
                if missing:
                    raise InputError(f"the robot stands: {missing}")
                self._turn.wait(_LOOK_UP)

    def _look(self) -> bool:
        """Whether there is a scan that shows what the policy needs, this one or one before."""
        if self._scan is not None:
            scan, self._scan = self._scan, None
            seen = self._reader.read(
                Turn(scan.ranges, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
            )
            self._lacks = seen.lacks or self._old(self._came - scan.stamp / BILLION)
            if not self._lacks:
                self._seen, self._seen_count = seen, self._seen_count + 1
                self._seen_at, self._seen_heard = self._came, self._heard
        return self._seen_count > 0

    def _old(self, age: float) -> str:
        """Why a scan of this age [s] cannot be driven by; "": it can."""
        if abs(age) < _ANOTHER:
            return stale("scan", age)
        return (
            "the scans have the time of another clock; if that of a simulation, begin after it, and in ROS 2 with "
            "use_sim_time"
        )

    def _missing(self, began: float, oldest: float) -> str:
        """What has not come for too long, in words; "": nothing. See `_wait`, which began at that wall-clock time."""
        wall, now, topics = time.monotonic(), self._graph.now(), self._topics
        for what, heard, at in (
            (self._lacks or f"no scan on {topics.scan}", self._seen_heard, self._seen_at),
            (f"no odometry on {topics.odometry}", self._counted_heard, self._counted_at),
        ):
            on_its_way = self._simulated and wall < heard + oldest  # in a simulation that is fast
            if (now > at + oldest and not on_its_way) or wall > max(heard, began) + _PATIENCE:
                return what
        return ""

    def _stands(self) -> bool:
        return bool((np.abs(self._odometry.twist) < _SLOW).all())

    def _put_back(self) -> None:
        if any(self._graph.call(service, EMPTY) for service in RESETS):
            return
        if sys.stdin is not None and sys.stdin.isatty():
            input(PUT_BACK)

    def _reading(self, duration: float) -> RobotState:
        """What was sensed last, `duration` [s] after the last reading."""
        (x, y, yaw), (v, w) = self._odometry.pose, self._odometry.twist
        at_x, at_y, at_yaw = self._origin
        start_x, start_y, start_yaw = self._initial_state.pose[0].tolist()
        cos, sin = math.cos(start_yaw - at_yaw), math.sin(start_yaw - at_yaw)
        east, north = x - at_x, y - at_y
        turned = math.remainder(start_yaw + yaw - at_yaw, math.tau)
        pose = np.array([start_x + cos * east - sin * north, start_y + sin * east + cos * north, turned])
        touched, self._touched = self._touched or self._pressed, False
        faster, self._speed = (v - self._speed) / duration, v
        twist, told = np.array([v, w]), np.array(self._told)
        return RobotState.of_one(
            (pose, twist, pose, twist, self._seen.ranges, touched, told, faster), self._initial_state, self
        )
