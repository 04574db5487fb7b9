"""Endings of episodes, and whether they count as failed or as a success."""

import numpy as np

from tb2rl.tasks import TIME_LIMIT, Ending, Outcome

REWARD = np.zeros(4)


def where(*indices):
    return np.isin(np.arange(4), indices)


def test_any_ending_terminates():
    failed, succeeded = {"collision": where(1), "stuck": where(0, 1)}, {"goal": where(1), "home": where(3)}
    assert Outcome(REWARD, failed, succeeded).terminated.tolist() == [True, True, False, True]
    assert Outcome(REWARD, {}, {"goal": where(2)}).terminated.tolist() == [False, False, True, False]
    assert not Outcome(REWARD, {}, {}).terminated.any()


def test_of_several_endings_the_first_counts_and_failed_ones_before_the_others():
    outcome = Outcome(
        REWARD,
        failed={"collision": where(0, 1), "stuck": where(0, 1, 2)},
        succeeded={"goal": where(0, 1, 2, 3), "home": where(3)},
    )
    endings = [outcome.ending(i, timed_out=True) for i in range(4)]
    assert [ending.name for ending in endings] == ["collision", "collision", "stuck", "goal"]
    assert [ending.failed for ending in endings] == [True, True, True, False]
    for indices in ([0, 1, 2, 3], [3, 0], [2]):
        assert outcome.endings(np.array(indices)) == [endings[i] for i in indices]


def test_the_time_limit_is_a_success_of_a_task_without_a_goal_only():
    lasted = Outcome(REWARD, failed={"collision": where(0)})
    assert lasted.ending(1, timed_out=True) == Ending(TIME_LIMIT, failed=False, success=True)
    missed = Outcome(REWARD, failed={"collision": where(0)}, succeeded={"goal": where(0)})
    assert missed.ending(1, timed_out=True) == Ending(TIME_LIMIT, failed=False, success=False)
    assert Outcome(REWARD, succeeded={}).ending(1, timed_out=True).success is False
