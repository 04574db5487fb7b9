"""Film frames have a rate of their own, are interpolated between control steps, and repeat the end for a second."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tb2rl.evaluation.moments import Moment
from tb2rl.simulation import InitialState, RobotState
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander
from tb2rl.viz.film_frames import film_frames, goal_of, interpolate_pose, mean_twist


@pytest.fixture
def moments(make_robot_state) -> list[Moment]:
    """An episode of ten steps along x, 0.1 m a step; a post moves the other way, as fast."""

    def robot_state(x: float) -> RobotState:
        return make_robot_state(pose=(x, 0.0, 0.0), dynamic_obstacles=np.array([[(3.0 - x, 1.0, -1.0, 0.0, 0.2, 0.0)]]))

    return [
        Moment(
            step=step,
            before=robot_state(0.1 * step - 0.1),
            after=robot_state(0.1 * step),
            action=np.array(0),
            reward=1.0,
            total=float(step),
            info={"ended": "goal" if step == 10 else None, "failed": False},
        )
        for step in range(1, 11)
    ]


@pytest.mark.parametrize(("rate", "speed"), [(15, 1.0), (30, 1.0), (10, 4.0), (10, 0.5)])
def test_frames_show_the_robot_and_obstacles_at_each_instant(rate, speed, moments):
    frames = list(film_frames(moments, period=0.2, rate=rate, speed=speed))
    during, end = [frame for frame in frames if not frame.ended], [frame for frame in frames if frame.ended]
    assert len(during) == math.ceil(10 * 0.2 * rate / speed - 1e-9)
    assert [frame.time for frame in during] == pytest.approx([i * speed / rate for i in range(len(during))])
    assert [frame.pose[0] for frame in during] == pytest.approx([0.5 * frame.time for frame in during])
    assert len(end) == rate, "a second of the last frame"
    assert {(frame.time, frame.pose[0], frame.episode_return) for frame in end} == {(2.0, 1.0, 10.0)}
    for frame in frames:
        assert frame.dynamic_obstacles.tolist() == [pytest.approx([3.0 - frame.pose[0], 1.0, -1.0, 0.0, 0.2, 0.0])]
        assert [pose[0] for pose in frame.path] == pytest.approx([0.1 * i for i in range(round(frame.episode_return))])


def test_poses_are_interpolated_by_the_shorter_turn_and_twists_are_in_the_robots_frame():
    before, after = np.array([0.0, 0.0, math.pi - 0.1]), np.array([1.0, 2.0, 0.1 - math.pi])
    assert interpolate_pose(before, after, 0.25) == pytest.approx([0.25, 0.5, math.pi - 0.05])
    assert mean_twist(before, before + (0.0, 0.0, 0.4 - math.tau), 0.2) == pytest.approx((0.0, 2.0))
    north = np.array([0.0, 0.0, math.pi / 2])
    assert mean_twist(north, north + (0.0, 0.1, 0.0), 0.2) == pytest.approx((0.5, 0.0))


def test_only_tasks_with_a_goal_have_one(make_spec):
    initial_state = InitialState.default(make_spec("wall"), 2)
    assert np.isnan(goal_of(Wander(), initial_state)).all(), "though the world has a goal"
    assert goal_of(ReachGoal(), initial_state).tolist() == [5.0, 0.0]
