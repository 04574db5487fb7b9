"""The commands of the page on ROS, in its order, against the simulated robot that it begins with."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
PAGE = Path(__file__).parents[3] / "tb2rl" / "deploy" / "ros" / "README.md"
SIM_TIME = ["--ros-args", "-p", "use_sim_time:=true"]
SHORTER = ["--steps", "3"]


def commands(version):
    """The words of the page's commands for this ROS, behind `python -m`."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    shown = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    ours = [words[2:] for words in shown if words[:2] == ["python", "-m"]]
    return [words for words in ours if ("--ros 2" in shlex.join(words)) == (version == 2)]


def on_ros(words, version):
    """Change a command for ROS 2 and a simulation, as the page explains."""
    more = [] if version == 1 or "--ros" in words else ["--ros", "2"]
    return [*words, *more, *(SIM_TIME if version == 2 and "--ros-args" not in words else [])]


def run(graph, words):
    """Run a command until it ends, or stop it once it drives; return its lines.

    The simulated scanner looks ahead: with the mounting of one that looks back, the driver sees too little and stands.
    """
    name, *arguments = words
    with graph.command(name.removeprefix("tb2rl."), *arguments) as driving:
        if name != "tb2rl.ros":
            assert driving.wait() == 0, driving.errors
            return driving.lines
        backwards = any("3.14159" in word for word in words)
        last = "it stands: the scan covers " if backwards else "dry run" if "--dry-run" in words else "driving"
        number = 0
        while not driving.wait_for_line(number).startswith(last):
            number += 1
        assert driving.stop() == 0, driving.errors
        return driving.lines


def test_all_commands_of_the_page_run(graph):
    version = graph.version
    (simulate,) = [words for words in commands(version) if "simulate" in words]
    drives = [words for words in commands(version) if "drive" in words]
    measures = [[*words, *SHORTER] for words in commands(1) if words[0] != "tb2rl.ros"]
    assert min(len(drives), len(measures)) >= 3
    with graph.command("ros", *simulate[1:]) as simulated:
        simulated.wait_for_line(0)
        for words in [*drives, *measures]:
            print(shlex.join(words), *run(graph, on_ros(words, version)), sep="\n  ")
        assert simulated.stop() == 0
