"""Where jobs are done, as a command line says it."""

from __future__ import annotations

import argparse
import re
import sys

import pytest

from tb2rl.core.errors import InputError, install_extra
from tb2rl.execution.where import Where, add_where, where_of


def where(*words: str) -> Where:
    parser = argparse.ArgumentParser()
    add_where(parser)
    return where_of(parser.parse_args(words))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], Where()),
        (["--workers", "3"], Where(workers=3)),
        (["--on", "ray"], Where(ray=True)),
        (["--on", "ray:10.0.0.1:6379", "--workers", "3"], Where(True, "10.0.0.1:6379", 3)),
    ],
)
def test_what_the_command_line_says(words, expected):
    assert where(*words) == expected
    assert sorted(expected.words) == sorted(words)


@pytest.mark.parametrize("words", [["--on", "spark"], ["--on", "ray:"], ["--workers", "0"], ["--on", ""]])
def test_what_it_cannot_say(words):
    with pytest.raises(InputError, match=r"--on takes ray, or ray:ADDRESS|--workers must be from 1"):
        where(*words)


def test_without_ray_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=re.escape(f"--on ray needs Ray: {install_extra('ray')}")):
        Where(ray=True).open(None)
