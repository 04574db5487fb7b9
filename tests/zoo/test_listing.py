"""`zoo list` and `zoo show`."""

import pytest

from tb2rl.zoo.__main__ import main
from tb2rl.zoo.entry import entries


def listed(capsys) -> list[str]:
    return [line.split()[1] for line in capsys.readouterr().out.splitlines() if line.startswith(("│", "|"))]


def test_the_list_has_every_policy(capsys):
    main(["list"])
    assert listed(capsys) == [entry.name for entry in entries()]


def test_the_list_is_filtered_by_task_robot_and_simulator(capsys):
    main(["list", "--task", "maze", "--robot", "turtlebot3", "--simulation", "mujoco"])
    assert listed(capsys) == ["maze-loop-turtlebot3-ppo"]


def test_a_filter_that_nothing_matches_is_an_error(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["list", "--robot", "jackal"])
    assert capsys.readouterr().err == "error: no policy of the zoo matches; `python -m tb2rl.zoo list` shows all\n"


def test_a_policy_is_shown_by_its_card(capsys):
    main(["show", "zoo:maze-loop-dqn"])
    assert "python -m tb2rl.train --agent dqn --simulation kinematic" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        main(["show", "maze-lop-dqn"])
    assert "did you mean 'maze-loop-dqn'?" in capsys.readouterr().err
