"""What ends an episode, and whether that counts as failed or as a success."""

import numpy as np
import pytest

from tb2rl.tasks import TIME_LIMIT, Ending, Outcome

REWARD = np.zeros(4)


def where(*robots):
    return np.isin(np.arange(4), robots)


def test_an_outcome_without_endings_ends_nothing():
    outcome = Outcome(reward=np.zeros(2))
    assert outcome.terminated.tolist() == [False, False]
    assert outcome.ending(0, timed_out=False) is None


@pytest.mark.parametrize(
    ("failed", "succeeded", "terminated"),
    [
        ({"collision": where(1)}, None, [1]),
        ({}, {"goal": where(2)}, [2]),
        ({"collision": where(1)}, {"goal": where(2)}, [1, 2]),
        ({"collision": where(1), "stuck": where(0, 1)}, {"goal": where(1), "home": where(3)}, [0, 1, 3]),
        ({}, {}, []),
    ],
)
def test_any_ending_terminates(failed, succeeded, terminated):
    assert np.flatnonzero(Outcome(REWARD, failed, succeeded).terminated).tolist() == terminated


def test_an_ending_says_by_its_place_whether_it_failed():
    outcome = Outcome(REWARD, failed={"collision": where(0)}, succeeded={"goal": where(1)})
    assert outcome.ending(0, timed_out=False) == Ending("collision", failed=True, success=False)
    assert outcome.ending(1, timed_out=False) == Ending("goal", failed=False, success=True)
    assert outcome.ending(2, timed_out=False) is None


def test_of_several_endings_the_first_counts_and_failed_ones_before_the_others():
    outcome = Outcome(
        REWARD,
        failed={"collision": where(0, 1), "stuck": where(0, 1, 2)},
        succeeded={"goal": where(0, 1, 2, 3), "home": where(3)},
    )
    assert [outcome.ending(robot, timed_out=True).name for robot in range(4)] == [
        "collision",
        "collision",
        "stuck",
        "goal",
    ]
    assert [outcome.ending(robot, timed_out=True).failed for robot in range(4)] == [True, True, True, False]


@pytest.mark.parametrize("succeeded", [None, {}, {"goal": where(0, 1, 2), "home": where(0, 3)}])
@pytest.mark.parametrize("failed", [{}, {"collision": where(0)}, {"collision": where(1), "stuck": where(0, 1)}])
def test_the_endings_of_several_robots_are_those_of_each(failed, succeeded):
    outcome = Outcome(REWARD, failed, succeeded)
    for num_envs in ([0, 1, 2, 3], [3, 0], [2]):
        each = [outcome.ending(robot, timed_out=True) for robot in num_envs]
        assert outcome.endings(np.array(num_envs)) == each


def test_the_time_limit_is_a_success_of_a_task_without_a_goal_only():
    lasted = Outcome(REWARD, failed={"collision": where(0)})
    assert lasted.ending(1, timed_out=True) == Ending(TIME_LIMIT, failed=False, success=True)
    missed = Outcome(REWARD, failed={"collision": where(0)}, succeeded={"goal": where(0)})
    assert missed.ending(1, timed_out=True) == Ending(TIME_LIMIT, failed=False, success=False)
    assert Outcome(REWARD, succeeded={}).ending(1, timed_out=True).success is False


def test_an_episode_that_ends_at_the_time_limit_by_itself_ends_for_its_own_reason():
    assert Outcome(REWARD, failed={"collision": where(0)}).ending(0, timed_out=True).name == "collision"
