"""The executor that a command line chooses."""

import re
import sys

import pytest

from tb2rl.core.command import ArgumentParser
from tb2rl.core.errors import InputError, install_extra
from tb2rl.execution.arguments import add_executor_arguments, make_executor
from tb2rl.execution.cluster import RayExecutor
from tb2rl.execution.local import LocalExecutor


def chosen(line: str):
    parser = ArgumentParser()
    add_executor_arguments(parser)
    return make_executor(parser.parse_args(line.split()))


@pytest.mark.parametrize(
    ("line", "kind"),
    [("", LocalExecutor), ("--workers 3", LocalExecutor), ("--on ray:10.0.0.1:6379 --workers 3", RayExecutor)],
)
def test_a_command_line_chooses_an_executor(line, kind):
    assert isinstance(chosen(line), kind)


@pytest.mark.parametrize("line", ["--on spark", "--on ray:", "--workers 0", "--on="])
def test_arguments_that_do_not_fit_are_refused(line):
    with pytest.raises(InputError, match=r"--on takes ray, or ray:ADDRESS|--workers: must be from 1"):
        chosen(line)


def test_without_ray_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=re.escape(f"--on ray needs Ray: {install_extra('ray')}")):
        list(RayExecutor().map(abs, [1]))
