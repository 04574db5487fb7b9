"""The last output line of the exported program is a stop, whatever comes in and whatever ends it."""

from __future__ import annotations

import io
import itertools
import json
import math
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import cache

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tb2rl.deploy.portable import main as program
from tb2rl.deploy.portable.policy import ExportedPolicy

SPEED, TURN_RATE = 0.2, 0.3  # [m/s], [rad/s]
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)]
SCAN = {"ranges": [3.0] * 181, "angle_min": -1.58, "angle_increment": 3.16 / 180, "range_min": 0.1, "range_max": 30.0}
ODOMETRY = {"x": 0.0, "y": 0.0, "yaw": 0.0, "v": 0.1, "w": 0.0}
GOOD = {"time": 1.0, "scan": SCAN, "odometry": ODOMETRY, "goal": [5.0, 1.0], "plan": [[1.0, 0.0], [5.0, 1.0]]}


def encoded(value):
    return json.dumps(value).encode()


def assert_ends_with_a_stop(output: bytes):
    """Each line is complete and within the limits, and the last one is a stop; returns the answers."""
    assert output.endswith(b"\n")
    answers = [json.loads(line) for line in output.splitlines()]
    assert [each for each in answers if not (abs(each["v"]) <= SPEED and abs(each["w"]) <= TURN_RATE)] == []
    assert (answers[-1]["v"], answers[-1]["w"]) == (0.0, 0.0)
    assert answers[-1]["why"].split()[-1] in ("ended", "wrong", "program")
    return answers


@pytest.fixture(scope="module")
def run(robot, tmp_path_factory):
    """A function that runs the program of a policy with a plan on input lines: exit status, stdout and stderr."""
    folder = tmp_path_factory.mktemp("follower")
    about = json.loads((robot / "policy.json").read_text())
    about["needs"] |= {"goal": "plan", "uses_odometry": True, "lookahead": 1.5}
    (folder / "policy.json").write_text(json.dumps(about))
    (folder / "weights.npz").write_bytes((robot / "weights.npz").read_bytes())
    start = encoded(GOOD) + b"\n" + encoded({"time": 1.1, "start": True}) + b"\n"

    def run(lines: bytes):
        output, errors, status = io.TextIOWrapper(io.BytesIO(), encoding="utf-8"), io.StringIO(), 0
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(program, "ExportedPolicy", cache(ExportedPolicy))
            patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(start + lines)))
            patch.setattr(sys, "stdout", output)
            patch.setattr(sys, "stderr", errors)
            try:
                program.main([str(folder), f"--speed={SPEED}", f"--turn-rate={TURN_RATE}"])
            except SystemExit as ended:
                status = ended.code
        return status, output.buffer.getvalue(), errors.getvalue()

    return run


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "JSONDecodeError"),
        ('{"bumber": true}', "unknown key 'bumber'; did you mean 'bumper'?"),
        ('{"goal": 3}', "float"),
        ('{"time": NaN}', "finite"),
        ('{"odometry": {"x": "far"}}', "far"),
        ('{"scan": {"ranges": []}}', "range_min"),
        ('{"scan": {"ranges": [[1, 2], [3, 4]]}}', "not a number"),
        ('{"odometry": {"x": 1e200}}', "finite number up to 1e+09"),
        ("[" * 100_000, "RecursionError"),
        ('{"start": "no"}', "true or false"),
        ('{"plan": [' + "[0, 0], " * 200_000 + "[0, 0]]}", "more than 1000000 bytes"),
    ],
)
def test_a_wrong_line_stops_the_robot_and_the_program(line, message, run):
    status, output, errors = run(line.encode())
    answers = assert_ends_with_a_stop(output)
    assert status == 2
    assert [answer["why"] for answer in answers[1:]] == ["driving", "a line that was wrong"]
    *_, last = errors.splitlines()
    assert last.startswith("error: ")
    assert message in last


NUMBERS = st.one_of(st.floats(), st.integers(), st.sampled_from([1e-320, 1e200, 10**400, True, math.nan, math.inf]))
ANY_JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.text(max_size=5), NUMBERS),
    lambda inner: st.one_of(st.lists(inner, max_size=6), st.dictionaries(st.sampled_from([*GOOD, *SCAN]), inner)),
    max_leaves=20,
)


def with_one_wrong(values):
    """Values by name, one of them replaced."""
    return st.tuples(st.sampled_from([*values]), ANY_JSON).map(lambda wrong: {**values, wrong[0]: wrong[1]})


LINES = st.one_of(
    with_one_wrong({**GOOD, "start": False, "stop": False, "bumper": False}).map(encoded),
    with_one_wrong(SCAN).map(lambda scan: encoded({**GOOD, "scan": scan})),
    with_one_wrong(ODOMETRY).map(lambda odometry: encoded({**GOOD, "odometry": odometry})),
    ANY_JSON.map(encoded),
    st.sampled_from([GOOD, {**GOOD, "time": 1.3, "start": True}, {"time": 1.4}, {"bumper": True}]).map(encoded),
    st.binary(max_size=40),
)


@pytest.mark.fuzz
def test_whatever_comes_in_the_last_line_is_a_stop(run):
    @settings(max_examples=300, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.lists(LINES, min_size=1, max_size=4))
    def check(lines):
        status, output, _ = run(b"\n".join(lines))
        answers = assert_ends_with_a_stop(output)
        assert answers[1]["why"] == "driving", "so that there is something to stop"
        assert status in (0, 2)
        assert len(answers) <= 3 + len(b"\n".join(lines).splitlines(keepends=True))

    check()


def feed(stream, stopped, last):
    """Write good lines until stopped or until nobody reads them; then write the last one, and close the stream."""
    with suppress(OSError):
        stream.write(encoded({**GOOD, "time": 0.0, "start": True}) + b"\n")
        for number in itertools.count():
            stream.write(encoded({**GOOD, "time": 0.01 * number}) + b"\n")
            stream.flush()
            if stopped.is_set():
                stream.write(last)
                break
    with suppress(OSError):
        stream.close()


def end(folder, ending, reads=True, pause=0.0, last=b""):
    """Run the program until a signal, or for None the end of its input, ends it; returns exit status and output.

    Args:
        reads: Whether to read an answer before the end; else the output may be empty.
        pause: Time before the end, without reading [s].
        last: The last input line.
    """
    command = [sys.executable, "drive.py", f"--speed={SPEED}", f"--turn-rate={TURN_RATE}"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    stopped = threading.Event()
    with subprocess.Popen(command, cwd=folder, **pipes) as process:
        feeder = threading.Thread(target=feed, args=(process.stdin, stopped, last))
        watchdog = threading.Timer(60.0, process.kill)  # a lost signal is a failure, not a test without an end
        feeder.start(), watchdog.start()
        output = b"".join(process.stdout.readline() for _ in range(3)) if reads else b""
        time.sleep(pause)
        stopped.set() if ending is None else process.send_signal(ending)
        output += process.stdout.read()
        process.wait()
        watchdog.cancel()
        feeder.join()
    return process.returncode, output


@pytest.mark.slow
@pytest.mark.parametrize("ending", [*SIGNALS, None], ids=lambda ending: getattr(ending, "name", "closed input"))
def test_whatever_ends_the_program_the_last_line_is_a_stop(ending, robot):
    # While it starts; soon; after a broken last line; late, when its output may fill the pipe.
    for reads, pause, last in ((False, 0.3, b""), (True, 0.0, b""), (True, 0.05, b'{"time": '), (True, 1.0, b"")):
        status, output = end(robot, ending, reads, pause, last)
        if reads or output:
            whys = [answer["why"] for answer in assert_ends_with_a_stop(output)]
            assert "driving" in whys or not reads
            expected = 128 + ending if ending else 2 if last else 0
            assert status == expected, f"after {ending!r} with {last}"


def test_a_signal_leads_to_a_stop(robot):
    status, output = end(robot, signal.SIGTERM)
    assert status == 143, "waited for the exit status after SIGTERM"
    assert assert_ends_with_a_stop(output)[-2]["why"] == "driving"
