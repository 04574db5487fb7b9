"""The table of an evaluation in the terminal: its metrics, and the success rate only of tasks with a goal."""

import re
from io import BytesIO, TextIOWrapper

from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.viz.table import print_evaluation


def test_the_table_has_the_metrics_of_the_evaluation(make, capsys):
    path = [(0.0, 2.0)] * 3
    episodes = [make.episode(path, [0, 0], "out of bounds", True), make.episode(path, [0, 0], "goal", False)]
    evaluation = make.evaluation(episodes, ReachGoal(episode_steps=7))
    assert print_evaluation(evaluation, "mine in wall") == evaluation.summary()
    title, _, *lines = [" ".join(re.split(r"[\s│┃]+", line)).strip() for line in capsys.readouterr().out.splitlines()]
    assert title == "mine in wall, kinematic simulator"
    for line in (
        "failure-free 50.0 % 95 % interval 9.5 to 90.5 %",
        "goal reached 50.0 % 95 % interval 9.5 to 90.5 %",
        "distance 123.4 ± 0.0 m",
        "visited 1 squares of 1 m (median)",
        "endings goal 1, out of bounds 1",
    ):
        assert line in lines


def test_without_a_goal_there_is_no_success_rate_and_without_unicode_no_sign(make, capsys, monkeypatch):
    evaluation = make.evaluation([make.episode([(0, 4), (1, 4)], [0])])
    print_evaluation(evaluation, "mine")
    assert "goal" not in capsys.readouterr().out
    stream = TextIOWrapper(BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", stream)
    print_evaluation(evaluation, "mine")
    stream.flush()
    assert "+/- 0.0 m" in stream.buffer.getvalue().decode("ascii")
