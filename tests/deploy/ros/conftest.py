"""Real graphs of ROS 1 and ROS 2, on this machine's loopback alone, and fakes of ROS and of wall-clock time.

ROS 1 is Debian's (see `.ci/run`), ROS 2 that of `make ros`, or of this Python; without them the tests are skipped. Fast
tests use `FakeNode` and `FakeClock`: a wait lets time pass at once, and no test waits for real time.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from tb2rl.deploy.ros.debian import PACKAGES
from tb2rl.deploy.ros.messages import Message

CHECKOUT = Path(__file__).parents[3]
DEBIANS_PYTHON = "/usr/bin/python3"
PATIENCE = 300.0  # [s] for a process to begin or to end: the machine may be busy


class Process:
    """A program in a process of its own; its lines can be read as they come."""

    def __init__(self, command: list[str], env: dict[str, str], folder: Path) -> None:
        self._output = Path(tempfile.mkdtemp(dir=folder))
        with (self._output / "lines").open("wb") as out, (self._output / "errors").open("wb") as err:
            pipes = {"stdin": subprocess.PIPE, "stdout": out, "stderr": err}
            self._process = subprocess.Popen(command, env=env, cwd=folder, text=True, bufsize=1, **pipes)

    @property
    def lines(self) -> list[str]:
        return (self._output / "lines").read_text().split("\n")[:-1]

    @property
    def errors(self) -> list[str]:
        return (self._output / "errors").read_text().splitlines()

    def wait_for_line(self, number: int) -> str:
        """Return line `number` of its stdout, once it is there."""
        until = time.monotonic() + PATIENCE
        while len(self.lines) <= number:
            ended = self._process.poll()
            assert ended is None or len(self.lines) > number, f"ended with {ended}: {self.lines} {self.errors}"
            assert time.monotonic() < until, f"no line {number}: {self.lines} {self.errors}"
            time.sleep(0.01)
        return self.lines[number]

    def wait(self) -> int:
        return self._process.wait(PATIENCE)

    def send_signal(self, sign: signal.Signals) -> None:
        self._process.send_signal(sign)

    def stop(self, sign: signal.Signals = signal.SIGINT) -> int:
        self.send_signal(sign)
        return self.wait()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


class Probe(Process):
    """A node with the methods of `tests/deploy/ros/probe.py`: `probe.take("/odom", count=3)`."""

    _asked = 0

    def __getattr__(self, method: str) -> Callable[..., Any]:
        def ask(*arguments: Any, **named: Any) -> Any:
            self._process.stdin.write(json.dumps([method, arguments, named]) + "\n")
            self._asked += 1
            return json.loads(self.wait_for_line(self._asked))

        return ask


class RosGraph:
    """A graph of ROS 1 or 2; environment variables join it, and a folder is that of its processes and logs."""

    def __init__(self, version: int, folder: Path, variables: dict[str, str]) -> None:
        self.version, self.folder = version, folder
        others = ("ROS", "RMW", "AMENT", "CMAKE_PREFIX", "PYTHONPATH", "PYTHONHOME")  # of the shell's own ROS
        inherited = {name: value for name, value in os.environ.items() if not name.startswith(others)}
        self.env = {**inherited, **variables, "ROS_HOME": str(folder), "ROS_LOG_DIR": str(folder / "log")}
        self.python = sys.executable if version == 1 else str(ros2_python())  # has both tb2rl and this ROS

    @contextmanager
    def process(self, command: list[str], path: str = "", kind: type[Process] = Process) -> Iterator[Any]:
        """Run a command; ROS 1 finds generated messages in the folder `messages`."""
        path = os.pathsep.join([path, str(self.folder / "messages")])
        process = kind(command, {**self.env, "PYTHONPATH": path}, self.folder)
        try:
            yield process
        finally:
            process.close()

    def command(self, name: str, *arguments: str, under: Sequence[str] = ()) -> AbstractContextManager[Process]:
        """`python -m tb2rl.NAME` with some arguments, under another program such as `nohup`."""
        return self.process([*under, self.python, "-m", f"tb2rl.{name}", *arguments], str(CHECKOUT))

    @contextmanager
    def start(self, name: str, *arguments: str, under: Sequence[str] = ()) -> Iterator[Process]:
        """`python -m tb2rl.ros NAME` with some arguments, after its first line."""
        with self.command("ros", name, "--ros", str(self.version), *arguments, under=under) as process:
            process.wait_for_line(0)
            yield process

    @contextmanager
    def probe(self) -> Iterator[Probe]:
        python = DEBIANS_PYTHON if self.version == 1 else self.python
        command = [python, str(Path(__file__).with_name("probe.py")), str(self.version)]
        with self.process(command, kind=Probe) as probe:
            probe.wait_for_line(0)
            yield probe


@contextmanager
def ros1(folder: Path) -> Iterator[RosGraph]:
    """A master on a free port."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    graph = RosGraph(1, folder, {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"})
    with graph.process(["rosmaster", "--core", "-p", str(port)]) as master:
        until = time.monotonic() + PATIENCE
        with socket.socket() as client:
            while client.connect_ex(("127.0.0.1", port)):
                assert time.monotonic() < until, f"no master on port {port}: {master.errors}"
                time.sleep(0.05)
        yield graph


def ros2_python() -> Path | None:
    """A Python that has rclpy and tb2rl."""
    made = CHECKOUT / ".venv-ros2" / "bin" / "python"
    if made.exists():
        return made
    return Path(sys.executable) if find_spec("rclpy") else None


@pytest.fixture(scope="module")
def graph1(tmp_path_factory):
    if not ((PACKAGES / "rospy").is_dir() and shutil.which("rosmaster")):
        pytest.skip("ROS 1 is not installed: apt-get install python3-rospy python3-rosmaster ... (see .ci/run)")
    with ros1(tmp_path_factory.mktemp("graph")) as graph:
        yield graph


@pytest.fixture(scope="module")
def graph2(tmp_path_factory):
    if ros2_python() is None:
        pytest.skip("ROS 2 is not installed: make ros")
    domain = str(1 + os.getpid() % 100)  # 101 is the largest that needs no ports that Linux gives to others
    variables = {"ROS_DOMAIN_ID": domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return RosGraph(2, tmp_path_factory.mktemp("graph"), variables)


@pytest.fixture(scope="module", params=["graph1", "graph2"], ids=["ros1", "ros2"])
def graph(request):
    return request.getfixturevalue(request.param)


class FakeEndpoint:
    """An endpoint that keeps what is published."""

    def __init__(self) -> None:
        self.peers, self.messages = True, list[Message]()
        self.react: Callable[[Any], None] = lambda message: None  # a program at the other end

    def connected(self) -> bool:
        return self.peers

    def publish(self, message: Message) -> None:
        self.messages.append(message)
        self.react(message)


class FakeNode:
    """A `tb2rl.deploy.ros.node.Node` without ROS: endpoints and callbacks by topic, and services, ours and others'."""

    def __init__(self) -> None:
        self.topics: dict[str, FakeEndpoint] = defaultdict(FakeEndpoint)
        self.receive: dict[str, Callable[[Any], None]] = {}
        self.services: dict[str, Callable[[], str | None]] = {}
        self.over, self.time, self.sim_time, self.announced = False, 0.0, False, False
        self.now, self.uses_sim_time, self.is_shutdown = lambda: self.time, lambda: self.sim_time, lambda: self.over

    def create_publisher(self, topic: str, message_type: type) -> FakeEndpoint:
        return self.topics[topic]

    def create_subscription(
        self, topic: str, message_type: type, callback: Callable[[Any], None], depth: int | None = None
    ) -> FakeEndpoint:
        self.receive[topic] = callback
        return self.topics[topic]

    def create_service(self, service: str, kind: str, callback: Callable[[], str | None]) -> None:
        self.services[service] = callback

    def call(self, service: str, kind: str) -> bool:
        if service in self.services:
            self.services[service]()
        return service in self.services

    def announce_sim_time(self) -> None:
        self.announced = True

    def close(self) -> None:
        self.over = True

    def commands(self, topic: str) -> list[tuple[float, float]]:
        return [(each.linear, each.angular) for each in self.topics[topic].messages]


class FakeClock:
    """A `WallClock` whose time passes in waits; `events` are called at each step of it."""

    def __init__(self) -> None:
        self.time, self.events = 0.0, list[Callable[[], None]]()
        self._timers: list[list[Any]] = []

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        until = self.time + seconds
        while self.time < until:
            self.time = min(until, self.time + 0.02)
            for timer in self._timers:
                period, due, callback = timer
                if self.time >= due:
                    timer[1] = self.time + period
                    callback()
            for event in list(self.events):
                event()

    def wait(self, condition: threading.Condition | threading.Event, seconds: float) -> bool:
        self.sleep(seconds)
        return isinstance(condition, threading.Event) and condition.is_set()

    def repeat(self, seconds: float, callback: Callable[[], None]) -> Callable[[], None]:
        self._timers.append([seconds, self.time + seconds, callback])
        return self._timers.clear


@pytest.fixture
def node() -> FakeNode:
    return FakeNode()


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()
