"""Progress bars: on a terminal only, gone at the end, and out of the way of what is printed."""

import re

from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.progress import progress, say
from tb2rl.runs.config import resolve


def test_a_bar_is_drawn_on_a_terminal_and_erased(terminal):
    stderr = terminal()
    assert list(progress(range(3), "counting", "thing")) == [0, 1, 2]
    drawn = stderr.getvalue()
    assert [part for part in ("counting:", "0/3", "thing") if part not in drawn] == []
    assert "\n" not in drawn
    assert drawn.endswith("\r")
    assert drawn.split("\r")[-2].strip() == "", "the last thing on its line is nothing"
    with progress(None, "filming", "step", total=2) as bar:
        bar.update()
        bar.refresh()
    assert "1/2" in stderr.getvalue(), "a caller can move the bar itself"


def test_the_remaining_time_leaves_out_the_wait_for_the_first_item(terminal, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("tqdm.std.time", lambda: clock[0])

    def things():
        for seconds in (16.0, *[1.0] * 10):
            clock[0] += seconds
            yield None

    stderr = terminal()
    list(progress(things(), "counting", "thing", total=11))
    drawn = dict(re.findall(r"(\d+)/11 \[\d+:\d+<([\d:?]+)", stderr.getvalue()))
    assert (drawn["1"], drawn["3"], drawn["8"]) == ("?", "00:08", "00:03")


def test_an_evaluation_draws_a_bar_only_on_request(terminal, forward):
    stderr = terminal()
    for shown in (False, True):
        evaluate(forward, resolve(), episodes=2, steps=3, simulation="kinematic", progress_bar=shown)
        assert ("evaluating:" in stderr.getvalue()) == shown


def test_a_line_is_printed_above_the_bars(terminal, capsys):
    stderr = terminal()
    for thing in progress(["one", "two"], "counting", "thing"):
        say(thing)
    assert capsys.readouterr().out == "one\ntwo\n"
    assert stderr.getvalue().count("0/2") > 1, "the bar is drawn anew below the line"


def test_no_bar_goes_into_a_file_or_a_pipe(capfd):
    assert list(progress(range(3), "counting", "thing")) == [0, 1, 2]
    assert capfd.readouterr() == ("", "")
