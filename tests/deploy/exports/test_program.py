"""The last output line of the exported program is a stop, whatever comes in and whatever ends it."""

import io
import json
import shutil
import signal
import subprocess
import sys
import time

import pytest

from tb2rl.deploy.portable.main import main

SPEED, TURN_RATE = 0.2, 0.3  # [m/s], [rad/s]
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)]
SCAN = {"ranges": [3.0] * 181, "angle_min": -1.58, "angle_increment": 3.16 / 180, "range_min": 0.1, "range_max": 30.0}
ODOMETRY = {"x": 0.0, "y": 0.0, "yaw": 0.0, "v": 0.1, "w": 0.0}
GOOD = {"time": 1.0, "scan": SCAN, "odometry": ODOMETRY, "goal": [5.0, 1.0], "plan": [[1.0, 0.0], [5.0, 1.0]]}


def encoded(**value):
    return json.dumps(value).encode() + b"\n"


def assert_ends_with_a_stop(output: bytes):
    """Each line is complete and within the limits, and the last one is a stop; returns the answers."""
    assert output.endswith(b"\n")
    answers = [json.loads(line) for line in output.splitlines()]
    assert [each for each in answers if not (abs(each["v"]) <= SPEED and abs(each["w"]) <= TURN_RATE)] == []
    assert (answers[-1]["v"], answers[-1]["w"]) == (0.0, 0.0)
    assert answers[-1]["why"].split()[-1] in ("ended", "program")
    return answers


@pytest.fixture(scope="module")
def follower(robot, tmp_path_factory):
    """The folder of a policy with a plan."""
    folder = shutil.copytree(robot, tmp_path_factory.mktemp("follower") / "policy")
    about = json.loads((robot / "policy.json").read_text())
    about["needs"] |= {"goal": "plan", "uses_odometry": True, "lookahead": 1.5}
    (folder / "policy.json").write_text(json.dumps(about))
    return folder


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "JSONDecodeError"),
        ('{"bumber": true}', "unknown key 'bumber'; the keys are time, scan, odometry, bumper"),
        ('{"goal": 3}', "float"),
        ('{"time": NaN}', "nan is not a number"),
        ('{"odometry": {"x": "far"}}', "far"),
        ('{"scan": {"ranges": []}}', "range_min"),
        ('{"scan": {"ranges": [[1, 2], [3, 4]]}}', "[1.0, 2.0] is not a number"),
        ('{"odometry": {"x": 1e200}}', "number from -1e+09 to 1e+09"),
        ("[" * 100_000, "RecursionError"),
        ('{"start": "no"}', "give true or false"),
        ('{"plan": [' + "[0, 0], " * 200_000 + "[0, 0]]}", "more than 1000000 bytes"),
    ],
)
def test_a_wrong_line_stops_the_robot_and_the_program(line, message, follower, monkeypatch, capsys):
    lines = encoded(**GOOD) + encoded(time=1.1, start=True) + line.encode()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(lines)))
    with pytest.raises(SystemExit) as stopped:
        main([str(follower), f"--speed={SPEED}", f"--turn-rate={TURN_RATE}"])
    output, errors = capsys.readouterr()
    answers = assert_ends_with_a_stop(output.encode())
    assert stopped.value.code == 2
    assert [answer["why"] for answer in answers[1:]] == ["driving", "an invalid line ended the program"]
    *_, last = errors.splitlines()
    assert last.startswith("error: ")
    assert message in last


FEEDER = 'printf "%s\\n" "$0"; yes "$1" | head -n $2; printf "%s" "$3"'  # a first line, good lines, and a last one


def end(folder, ending, reads=True, pause=0.0, last=""):
    """Run the program until a signal, or for None the end of its input, ends it; returns exit status and output.

    Args:
        reads: Whether to read an answer before the end; else the output may be empty.
        pause: Time before the signal, without reading [s].
        last: The last input line.
    """
    first, good = (json.dumps({**GOOD, "time": 0.0, **start}) for start in ({"start": True}, {}))
    count = "20000" if ending else "300"  # without the signal it takes many seconds
    program = [sys.executable, "drive.py", f"--speed={SPEED}", f"--turn-rate={TURN_RATE}"]
    with subprocess.Popen(["sh", "-c", FEEDER, first, good, count, last], stdout=subprocess.PIPE) as feeder:
        pipes = {"stdin": feeder.stdout, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(program, cwd=folder, **pipes) as process:
            feeder.stdout.close()  # so that it ends with the program
            output = b"".join(process.stdout.readline() for _ in range(3)) if reads else b""
            time.sleep(pause)
            if ending:
                process.send_signal(ending)
            output += process.stdout.read()
    return process.returncode, output


@pytest.mark.slow
@pytest.mark.parametrize("ending", [*SIGNALS, None], ids=lambda ending: getattr(ending, "name", "closed input"))
def test_whatever_ends_the_program_the_last_line_is_a_stop(ending, robot):
    # While it starts; soon; after a broken last line; late, when its output may fill the pipe.
    for reads, pause, last in ((False, 0.3, ""), (True, 0.0, ""), (True, 0.05, '{"time": '), (True, 1.0, "")):
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
