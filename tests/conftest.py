"""Fixtures of several rooms: specs, robot states, a suite, a run, an unprivileged user, a fake hub."""

import base64
import hashlib
import json
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from ctypes.util import find_library
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import import_module
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from threading import Thread
from urllib.parse import unquote

import numpy as np
import pytest
import torch as th

from tb2rl import train
from tb2rl.commands import evaluate as suite_command
from tb2rl.core import InputError, plugins
from tb2rl.evaluation import suites
from tb2rl.robots import Robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.simulation.simulator import default_simulator
from tb2rl.worlds import World
from tb2rl.worlds.registry import find_world
from tb2rl.worlds.suites import Suite

# Tests send these signals, which pytest and its children ignore if a shell started pytest in the background.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

th.set_num_threads(1)  # because the networks are small and other tests use the processors


def pytest_collection_modifyitems(items) -> None:
    """Start the longest tests first, so that no worker waits for them at the end. Skip what lacks PyBullet."""
    items.sort(key=lambda item: item.get_closest_marker("first") is None)
    if find_spec("pybullet") is None:
        for item in items:
            parameters = {*re.split(r"[][-]", item.name)}
            if item.get_closest_marker("bullet") or parameters & {"bullet", "chase"}:  # PyBullet has the chase camera
                item.add_marker(pytest.mark.skip("PyBullet is not installed"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Skip a test of MuJoCo's camera where OpenGL is not installed, and on other systems where it fails."""
    try:
        return (yield)
    except InputError as error:
        if "camera needs OpenGL" in str(error) and not (sys.platform == "linux" and find_library("EGL")):
            pytest.skip(str(error))
        raise


FLOOR = World.from_shapes("floor", start=(0.0, 0.0, 0.0), bounds=(-9.0, -9.0, 9.0, 9.0))


def _spec(*worlds: World | str, robot: Robot = ROBOT, **laser) -> SimulationSpec:
    """A robot in some worlds (an open floor by default); `laser` changes fields of its laser."""
    found = tuple(find_world(world) if isinstance(world, str) else world for world in worlds)
    return SimulationSpec(robot, replace(robot.laser, **laser), found or (FLOOR,))


def _robot_state(
    nearest_range=3.0,
    ranges=None,
    bumped=False,
    pose=(0.0, 0.0, 0.0),
    odometry=None,
    twist=(0.0, 0.0),
    goal=(math.nan, math.nan),
    bounds=(-9.0, -9.0, 9.0, 9.0),
    **others,
) -> RobotState:
    """A robot state of as many environments as the longest argument has; a single value holds for all.

    `ranges` are (num_envs, beams) or (beams,); by default there are three beams, the middle one of `nearest_range` [m].
    `others` are further fields; the robots are at rest by default.
    """
    if ranges is None:
        ranges = np.full((np.size(nearest_range), 3), math.inf)
        ranges[:, 1] = nearest_range
    pose, twist, ranges = (np.atleast_2d(np.array(values, float)) for values in (pose, twist, ranges))
    num_envs = max(len(pose), len(twist), len(ranges), np.size(bumped))
    start = InitialState.default(_spec(), num_envs)
    start.goal[:], start.bounds[:] = goal, bounds
    pose, twist = np.broadcast_to(pose, (num_envs, 3)), np.broadcast_to(twist, (num_envs, 2))
    at_rest = {"odometry_twist": twist, "command": np.zeros((num_envs, 2)), "acceleration": np.zeros(num_envs)}
    return RobotState(
        pose=pose,
        twist=twist,
        odometry=pose if odometry is None else np.broadcast_to(np.array(odometry, float), (num_envs, 3)),
        ranges=np.broadcast_to(ranges, (num_envs, ranges.shape[1])),
        bumped=np.broadcast_to(np.array(bumped), num_envs),
        initial_state=start,
        **(at_rest | others),
    )


def _small_suite(name: str = "unseen", last: float = 1.0) -> Suite:
    """Three worlds of two families, the last at `y = last`; no policy reaches a goal within the time limit."""
    bounds, walls = (-4.0, -4.0, 4.0, 4.0), [(0.0, 3.5, 6.0, 0.2, 0.0)]
    worlds = tuple(
        World.from_shapes(f"at {y:g}", walls, start=(-2.0, y, 0.0), goal=(0.0, y, 0.0), bounds=bounds)
        for y in (-1.0, 0.0, last)
    )
    return Suite(name, worlds, ("a", "b", "a"), (2.0, 2.0, 2.0), 1.0)


@pytest.fixture(scope="session")
def trained_run(tmp_path_factory) -> Path:
    """A run folder with a policy that has learned next to nothing; copy it before you write to it."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    train("qlearn", simulation="kinematic", total_timesteps=64, n_envs=4, eval_freq=0, save_freq=0, folder=folder)
    return folder


@pytest.fixture
def make_spec():
    return _spec


@pytest.fixture
def make_robot_state():
    return _robot_state


@pytest.fixture
def small_suite():
    return _small_suite


@pytest.fixture
def workdir(tmp_path, monkeypatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def module_folder(workdir, monkeypatch) -> Path:
    """The working directory, on the path of Python, whose modules are forgotten after the test."""
    monkeypatch.syspath_prepend(workdir)
    known = set(sys.modules)
    yield workdir
    for name in set(sys.modules) - known:
        if str(workdir) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


REFEREES = """
from tb2rl.simulation.kinematic.simulator import KinematicSimulator


class First(KinematicSimulator):
    title, is_physics = "First", True


class Second(KinematicSimulator):
    title, is_physics = "Second", True

    def step(self, commands, duration, inactive=None):
        return super().step(commands * (0.5, 0.0), duration, inactive)  # slow robots that cannot turn
"""


@pytest.fixture
def referees(module_folder, monkeypatch):
    """Registers two physics simulators in place of the real ones; a function makes one of them (un)available."""
    (module_folder / "referees.py").write_text(REFEREES)
    others = {name: plugins.SIMULATORS[name] for name in ("kinematic", "ros")}
    monkeypatch.setattr(plugins, "SIMULATORS", {"first": "referees:First", "second": "referees:Second", **others})
    default_simulator.cache_clear()

    def set_available(name: str, available: bool) -> None:
        problem = staticmethod(lambda: None if available else "is not installed")
        monkeypatch.setattr(getattr(import_module("referees"), name), "unavailable", problem, raising=False)
        default_simulator.cache_clear()

    yield set_available
    default_simulator.cache_clear()


@pytest.fixture
def terminal(monkeypatch):
    """A function that makes stderr a terminal during the test, and returns its stream."""

    def opened() -> StringIO:
        stream = StringIO()
        stream.isatty = lambda: True
        monkeypatch.setattr(sys, "stderr", stream)
        return stream

    return opened


@pytest.fixture
def unseen(monkeypatch) -> None:
    """The suite `unseen` is a `_small_suite`."""
    for module in (suite_command, suites):
        monkeypatch.setattr(module, "find_suite", lambda name, path: _small_suite(name))


@pytest.fixture
def refused(workdir, capsys):
    """A function that runs a command and returns its error: one line that names words, with status 2, and no files."""

    def message(main, line: str | list[str], named: Sequence[str] = ()) -> str:
        before = sorted(workdir.rglob("*"))
        with pytest.raises(SystemExit) as stopped:
            main(shlex.split(line) if isinstance(line, str) else line)
        error = capsys.readouterr().err
        assert (stopped.value.code, error.count("\n")) == (2, 1), error
        assert [word for word in named if word not in error] == [], error
        assert sorted(workdir.rglob("*")) == before, "it leaves nothing behind"
        return error

    return message


@pytest.fixture
def driven(monkeypatch) -> list[int]:
    """Indices of the suite worlds that were driven, in order."""
    run_suite, driven = suite_command.run_suite, []

    def recorded(*arguments):
        for drive in run_suite(*arguments):
            driven.append(drive.world)
            yield drive

    monkeypatch.setattr(suite_command, "run_suite", recorded)
    return driven


@pytest.fixture
def write_package(module_folder):
    """A function that writes an installed package: its entry points, and modules by name."""

    def write(entry_points: str, **modules: str) -> None:
        info = module_folder / "stranger-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entry_points)
        for name, code in modules.items():
            (module_folder / f"{name}.py").write_text(code)

    return write


_NOBODY = 65534


class Guest:
    """An unprivileged user who can read all files but write to few, as in a container image.

    If the tests run as root, it is another user that keeps root's right to read: Python may stand in root's home.
    """

    def __init__(self, folder: Path) -> None:
        self.is_root, self._locked = os.geteuid() == 0, list[Path]()
        self.scratch = self.own(folder)

    def own(self, folder: Path) -> Path:
        """Make a folder that this user may write to."""
        folder.mkdir()
        if self.is_root:
            os.chown(folder, _NOBODY, _NOBODY)
        return folder

    def lock(self, folder: Path) -> None:
        """Make a folder read-only for this user until the test ends."""
        for place in (folder, *folder.rglob("*/")):
            if place.is_dir() and not place.is_symlink():
                self._locked.append(place)
                place.chmod(0o555)

    def unlock(self) -> None:
        """Make all folders writable again."""
        for place in self._locked:
            place.chmod(0o755)

    def run(self, command: Sequence[str], **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a command as this user, without a home, with `scratch` for temporary files."""
        may_read = ["--inh-caps", "+dac_read_search", "--ambient-caps", "+dac_read_search"]
        user = ["setpriv", f"--reuid={_NOBODY}", f"--regid={_NOBODY}", "--clear-groups", *may_read]
        ours = ("NUMBA", "TB2RL", "XDG", "PYTEST")
        kept = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
        env = {**kept, "HOME": "/nonexistent", "TMPDIR": str(self.scratch), "PYTHONDONTWRITEBYTECODE": "1", **variables}
        words = [*(user if self.is_root else ()), *command]
        return subprocess.run(words, cwd=self.scratch, env=env, capture_output=True, text=True, check=False)


@pytest.fixture
def guest(tmp_path):
    """A `Guest`."""
    if os.name != "posix" or (os.geteuid() == 0 and not shutil.which("setpriv")):
        pytest.skip("an unprivileged user takes setpriv, or tests that do not run as root")
    user = Guest(tmp_path / "scratch")
    yield user
    user.unlock()


class FakeHub(ThreadingHTTPServer):
    """A server of the Hugging Face hub on the loopback for reading and writing files; each upload is a commit.

    Attributes:
        repositories: Commits of each repository; a commit maps paths to contents.
        refuses: Status and error code of every answer, if set.
        authorisations: Authorization headers of the requests.
    """

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), HubHandler)
        self.repositories: dict[str, list[dict[str, bytes]]] = {}
        self.refuses: tuple[int, str] | None = None
        self.authorisations: list[str] = []
        self.address = f"http://127.0.0.1:{self.server_port}"
        Thread(target=self.serve_forever, args=(0.01,), daemon=True).start()

    def put(self, repository: str, files: Mapping[str, bytes]) -> str:
        """Commit changes of files and return the hash."""
        commits = self.repositories.setdefault(repository, [])
        commits.append({**(commits[-1] if commits else {}), **files})
        return self.hashes(repository)[-1]

    def hashes(self, repository: str) -> list[str]:
        return [digest(f"{repository} {number}".encode()) for number in range(len(self.repositories[repository]))]

    def answer(self, path: str, body: bytes) -> object:
        """The content of a file, a JSON tree, or the error code of what is not there."""
        if path == "/api/repos/create":
            given = json.loads(body)
            repository = "/".join(name for name in (given.get("organization"), given["name"]) if name)
            self.repositories.setdefault(repository, [])
            return {"url": f"{self.address}/{repository}", "name": repository}
        if path == "/api/validate-yaml":
            return {"errors": [], "warnings": []}
        pattern = r"(?:/api/models)?/([^/]+/[^/]+)(?:/(revision|tree|preupload|commit|resolve)/(.*))?"
        repository, verb, rest = re.fullmatch(pattern, path).groups()
        if repository not in self.repositories:
            return "RepoNotFound"
        if verb == "preupload":
            paths = [file["path"] for file in json.loads(body)["files"]]
            return {"files": [{"path": path, "uploadMode": "regular", "shouldIgnore": False} for path in paths]}
        if verb == "commit":
            lines = [json.loads(line)["value"] for line in body.splitlines()[1:]]
            commit = self.put(repository, {line["path"]: base64.b64decode(line["content"]) for line in lines})
            return {"commitUrl": f"{self.address}/{repository}/commit/{commit}", "commitOid": commit}
        hashes, (revision, _, file) = self.hashes(repository), (rest or "main").partition("/")
        if not hashes or revision not in ("main", *hashes):
            return "RevisionNotFound"
        number = hashes.index(revision) if revision in hashes else len(hashes) - 1
        files = self.repositories[repository][number]
        if verb == "tree":
            return [{"type": "file", "path": p, "size": len(c), "oid": digest(c)} for p, c in files.items()]
        if verb == "resolve":
            return (files[file], hashes[number]) if file in files else "EntryNotFound"
        siblings = [{"rfilename": path, "size": len(content)} for path, content in files.items()]
        return {"id": repository, "sha": hashes[number], "siblings": siblings}


def digest(content: bytes) -> str:
    return hashlib.sha1(content).hexdigest()


class HubHandler(BaseHTTPRequestHandler):
    """Answers the requests to a `FakeHub`."""

    protocol_version = "HTTP/1.1"

    def answer(self) -> None:
        hub: FakeHub = self.server
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        hub.authorisations.append(self.headers.get("Authorization", ""))
        answer = hub.refuses or hub.answer(unquote(self.path.partition("?")[0]), body)
        if answer == hub.refuses or isinstance(answer, str):
            status, code = hub.refuses or (404, answer)
            content, headers = b"{}", {"X-Error-Code": code}
        elif isinstance(answer, tuple):
            status, (content, commit) = 200, answer
            headers = {"X-Repo-Commit": commit, "ETag": f'"{digest(content)}"'}
        else:
            status, content, headers = 200, json.dumps(answer).encode(), {"Content-Type": "application/json"}
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    do_GET = do_HEAD = do_POST = answer  # noqa: N815 (http.server's names)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A `FakeHub` for the library and for processes of a test, with an empty cache."""
    constants = pytest.importorskip("huggingface_hub.constants", reason="the extra `hub` is not installed")
    fake, home = FakeHub(), tmp_path / "huggingface"
    for name, value in {"HF_ENDPOINT": fake.address, "HF_HOME": str(home), "HF_HUB_DISABLE_XET": "1"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("HF_TOKEN", raising=False)
    paths = {"HF_HOME": home, "HF_HUB_CACHE": home / "hub", "HF_TOKEN_PATH": home / "token"}
    address = {
        "ENDPOINT": fake.address,
        "HUGGINGFACE_CO_URL_TEMPLATE": f"{fake.address}/{{repo_id}}/resolve/{{revision}}/{{filename}}",
    }
    for name, value in {**address, **{name: str(path) for name, path in paths.items()}}.items():
        monkeypatch.setattr(constants, name, value)  # read from the environment once
    fake.cache = home
    yield fake
    import_module("huggingface_hub").close_session()
    fake.shutdown()
    fake.server_close()
