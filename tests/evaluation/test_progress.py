"""Progress bars: on a terminal only, gone at the end, and out of the way of what is printed."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable

import pytest

from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.progress import progress, say
from tb2rl.runs.layers import resolve


class Terminal(io.StringIO):
    """What stderr is in a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def to_terminal(monkeypatch) -> Callable[[], Terminal]:
    """A function that makes stderr a terminal until the end of the test (pytest puts its own there when one begins)."""

    def begin() -> Terminal:
        monkeypatch.setattr(sys, "stderr", Terminal())
        return sys.stderr

    return begin


def test_a_bar_is_drawn_on_a_terminal_and_erased(to_terminal):
    terminal = to_terminal()
    assert list(progress(range(3), "counting", "thing")) == [0, 1, 2]
    drawn = terminal.getvalue()
    assert [part for part in ("counting:", "0/3", "thing") if part not in drawn] == []
    assert "\n" not in drawn
    assert drawn.endswith("\r")
    assert drawn.split("\r")[-2].strip() == "", "the last thing on its line is nothing"


def test_a_caller_can_move_the_bar_itself(to_terminal):
    terminal = to_terminal()
    with progress(None, "filming", "step", total=2) as bar:
        bar.update()
        bar.refresh()
    assert "1/2" in terminal.getvalue()


def test_the_remaining_time_leaves_out_the_wait_for_the_first_item(to_terminal, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("tqdm.std.time", lambda: clock[0])

    def things():
        for seconds in (16.0, *[1.0] * 10):
            clock[0] += seconds
            yield None

    terminal = to_terminal()
    list(progress(things(), "counting", "thing", total=11))
    drawn = {
        int(done): remaining for done, remaining in re.findall(r"(\d+)/11 \[\d+:\d+<([\d:?]+)", terminal.getvalue())
    }
    assert (drawn[1], drawn[3], drawn[8]) == ("?", "00:08", "00:03")


def test_no_bar_goes_into_a_file_or_a_pipe(capfd):
    assert list(progress(range(3), "counting", "thing")) == [0, 1, 2]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("shown", [True, False])
def test_an_evaluation_draws_a_bar_only_on_request(shown, to_terminal, forward):
    terminal = to_terminal()
    evaluate(forward, resolve(), episodes=2, steps=3, simulation="kinematic", progress=shown)
    assert ("evaluating:" in terminal.getvalue()) == shown
    assert ("0/2" in terminal.getvalue()) == shown


def test_a_line_is_printed_above_the_bars(to_terminal, capsys):
    terminal = to_terminal()
    for thing in progress(["one", "two"], "counting", "thing"):
        say(thing)
    assert capsys.readouterr().out == "one\ntwo\n"
    assert terminal.getvalue().count("0/2") > 1, "the bar is drawn anew below the line"
