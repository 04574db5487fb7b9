"""The exported program's last line says to stand, whatever comes in and whatever ends it.

WRONG_INPUTS=10000 ENDINGS=200 pytest -m "slow or not slow" -s tests/deploy/exports/test_program.py
"""

from __future__ import annotations

import copy
import io
import json
import math
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from functools import cache

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tb2rl.commands.export import export_folder
from tb2rl.deploy.portable import main as program
from tb2rl.deploy.portable.policy import ExportedPolicy

WRONG_INPUTS = int(os.environ.get("WRONG_INPUTS", "150"))  # for each policy
ENDINGS = int(os.environ.get("ENDINGS", "4"))  # by each signal
SPEED, TURN_RATE = 0.2, 0.3  # [m/s], [rad/s]
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)]
SCAN = {"ranges": [3.0] * 181, "angle_min": -1.58, "angle_increment": 3.16 / 180, "range_min": 0.1, "range_max": 30.0}
ODOMETRY = {"x": 0.0, "y": 0.0, "yaw": 0.0, "v": 0.1, "w": 0.0}
GOOD = {"time": 1.0, "scan": SCAN, "odometry": ODOMETRY, "goal": [5.0, 1.0], "plan": [[1.0, 0.0], [5.0, 1.0]]}
NUMBERS = st.one_of(
    st.floats(),
    st.integers(),
    st.sampled_from([0, -1, 1e-320, 1e9, 1e154, 1e200, -1.7e308, 2**63, 10**400, 10**4299, True, math.nan, math.inf]),
)
ANY_JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.text(max_size=5), NUMBERS),
    lambda inner: st.one_of(
        st.lists(inner, max_size=6), st.dictionaries(st.sampled_from([*GOOD, "start", *SCAN, *ODOMETRY]), inner)
    ),
    max_leaves=20,
)


def parts(value, path=()):
    """The paths to all parts of a value; of a long list, to its first two."""
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(value, list) else ()
    for key, part in inner:
        yield from parts(part, (*path, key))


def put(path, part):
    """A good line with one part in the place of another."""
    if not path:
        return part
    line = copy.deepcopy(GOOD)
    *parents, last = path
    holder = line
    for key in parents:
        holder = holder[key]
    holder[last] = part
    return line


def nested(depth):
    return b"[" * depth + b"]" * depth


def encoded(value):
    return json.dumps(value).encode()


LINES = st.one_of(
    st.builds(put, st.sampled_from([*parts(GOOD), ("start",), ("stop",), ("bumper",)]), ANY_JSON).map(encoded),
    ANY_JSON.map(encoded),
    st.sampled_from([GOOD, {**GOOD, "time": 1.3, "start": True}, {"time": 1.4}, {"bumper": True}]).map(encoded),
    st.binary(max_size=40),
    st.integers(1, 100_000).map(nested),
    st.integers(1, 100_000).map(lambda depth: b'{"scan": {"ranges": ' + nested(depth) + b"}}"),
    st.integers(1, 6000).map(lambda digits: b'{"time": ' + b"9" * digits + b"}"),
    st.sampled_from([b"", b" " * 1_100_000, b'{"plan": [' + b"[0, 0], " * 200_000 + b"[0, 0]]}"]),
)


def assert_stands_at_the_end(output: bytes, speed=SPEED, turn_rate=TURN_RATE):
    """Every line is whole, none is too fast, and the last one says to stand."""
    assert output.endswith(b"\n")
    answers = [json.loads(line) for line in output.splitlines()]
    assert [each for each in answers if not (abs(each["v"]) <= speed and abs(each["w"]) <= turn_rate)] == []
    assert (answers[-1]["v"], answers[-1]["w"]) == (0.0, 0.0)
    assert answers[-1]["why"].split()[-1] in ("ended", "wrong", "program")
    return answers


def run(folder, lines: bytes, monkeypatch):
    """The program, in this process: its exit status and what it answered."""
    output = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(lines)))
    monkeypatch.setattr(sys, "stdout", output)
    status = 0
    try:
        program.main([str(folder), f"--speed={SPEED}", f"--turn-rate={TURN_RATE}"])
    except SystemExit as ended:
        status = ended.code
    return status, output.buffer.getvalue()


@pytest.fixture(scope="module")
def follower(robot, tmp_path_factory):
    """The folder of a policy that is told a plan, and so needs odometry, too."""
    folder = tmp_path_factory.mktemp("follower")
    about = json.loads((robot / "policy.json").read_text())
    about["needs"] |= {"goal": "plan", "uses_odometry": True, "lookahead": 1.5}
    (folder / "policy.json").write_text(json.dumps(about))
    (folder / "weights.npz").write_bytes((robot / "weights.npz").read_bytes())
    return folder


@pytest.mark.parametrize(
    "policy", ["", *(pytest.param(n, marks=pytest.mark.slow) for n in ("navigate-plan-ppo", "anywhere-qlearn"))]
)
def test_whatever_comes_in_the_last_line_says_to_stand(policy, follower, tmp_path_factory, monkeypatch):
    folder = follower
    if policy:
        folder = tmp_path_factory.mktemp("exported")
        export_folder(f"zoo:{policy}", folder)
    monkeypatch.setattr(program, "ExportedPolicy", cache(ExportedPolicy))
    first = encoded(GOOD) + b"\n" + encoded({"time": 1.1, "start": True}) + b"\n"
    statuses, driven = Counter(), Counter()

    @settings(max_examples=WRONG_INPUTS, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.lists(LINES, min_size=1, max_size=4))
    def check(lines):
        status, output = run(folder, first + b"\n".join(lines), monkeypatch)
        answers = assert_stands_at_the_end(output)
        assert answers[1]["why"] == "driving", "so that there is something to stop"
        assert status in (0, 2)
        assert len(answers) <= 3 + len(b"\n".join(lines).splitlines(keepends=True))
        statuses[status] += 1
        driven[sum(answer["why"] == "driving" for answer in answers)] += 1

    check()
    print(policy or "follower", dict(statuses), "lines driven:", dict(driven), file=sys.__stderr__)
    assert statuses[2] > WRONG_INPUTS / 3


def feed(stream, stopped, last):
    """Write good lines as fast as they are read, until told to stop; then write the last one, and close the stream."""
    first = {**GOOD, "time": 0.0}
    with suppress(OSError):
        stream.write(encoded(first) + b"\n" + encoded({"time": 0.0, "start": True}) + b"\n")
        for number in range(10**9):
            stream.write(encoded({**first, "time": 0.01 * number}) + b"\n")
            stream.flush()
            if stopped.is_set():
                stream.write(last)
                break
    with suppress(OSError):
        stream.close()


def end(folder, ending, reads=True, pause=0.0, last=b""):
    """Start the program, end it by a signal, or None: by the end of its input; its exit status and its output.

    Args:
        folder: Of the policy.
        ending: The signal.
        reads: Whether an answer is read before: then the promise holds. Else the output may be empty.
        pause: How long to wait before the end, and meanwhile read nothing [s].
        last: What its input ends with.
    """
    command = [sys.executable, "drive.py", f"--speed={SPEED}", f"--turn-rate={TURN_RATE}"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    stopped = threading.Event()
    with subprocess.Popen(command, cwd=folder, **pipes) as process:
        feeder = threading.Thread(target=feed, args=(process.stdin, stopped, last))
        feeder.start()
        watchdog = threading.Timer(60.0, process.kill)  # a lost signal is a failure, and not a test without an end
        watchdog.start()
        output = b"".join(process.stdout.readline() for _ in range(3)) if reads else b""
        time.sleep(pause)
        if ending:
            process.send_signal(ending)
        else:
            stopped.set()
        output += process.stdout.read()
        process.wait()
        watchdog.cancel()
        feeder.join()
    return process.returncode, output


@pytest.fixture
def hangup():
    """Processes heed a hangup, although this one may have been told by `nohup` to ignore it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.slow
@pytest.mark.parametrize("ending", [*SIGNALS, None], ids=lambda ending: getattr(ending, "name", "closed input"))
def test_whatever_ends_it_the_last_line_says_to_stand(ending, robot, hangup):
    rng, found = random.Random(0), Counter()
    for number in range(ENDINGS):
        reads = number % 4 > 0  # else it ends while it begins
        longest = (0.6, 0.05, 0.05, 1.0)[number % 4]  # [s] in the last one its output may fill the pipe
        last = (b"", b'{"time": ')[number // 4 % 2]
        status, output = end(robot, ending, reads, rng.uniform(0.0, longest), last)
        if reads or output:
            whys = [answer["why"] for answer in assert_stands_at_the_end(output)]
            assert "driving" in whys or not reads
            assert status == (128 + ending if ending else 2 if last else 0)
        found["an answer was read" if reads else "it began", "with lines" if output else "without a line", status] += 1
    print(found, file=sys.__stderr__)


@pytest.mark.parametrize(("ending", "status"), [(signal.SIGTERM, 143), (None, 0)])
def test_a_signal_or_the_end_of_its_input_has_it_say_to_stand(ending, status, robot):
    found, output = end(robot, ending)
    assert found == status
    assert assert_stands_at_the_end(output)[-2]["why"] == "driving"
