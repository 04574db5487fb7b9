"""The instants of a drive: at a rate of their own, on the way between control steps, the end long enough to be seen."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from tb2rl.viz.shots import between, shots, speeds


def moments(steps: int) -> list[SimpleNamespace]:
    """A drive along x, 0.1 m a step, that ends with the last one; a post goes the other way, as fast."""
    poses = [np.array([0.1 * step, 0.0, 0.0]) for step in range(steps + 1)]
    dynamic_obstacles = [np.array([(3.0 - pose[0], 1.0, -1.0, 0.0, 0.2, 0.0)]) for pose in poses]
    return [
        SimpleNamespace(
            step=i + 1,
            before=poses[i],
            pose=poses[i + 1],
            dynamic_obstacles_before=dynamic_obstacles[i],
            dynamic_obstacles=dynamic_obstacles[i + 1],
            info={"ended": "goal" if i == steps - 1 else None},
        )
        for i in range(steps)
    ]


@pytest.mark.parametrize(("rate", "speed"), [(10, 1.0), (15, 1.0), (30, 1.0), (10, 4.0), (10, 0.5)])
def test_the_robot_is_shown_where_it_is_at_each_instant(rate, speed):
    driven = moments(10)
    shown = list(shots(driven, period=0.2, rate=rate, speed=speed))
    during, end = [s for s in shown if not s.over], [s for s in shown if s.over]
    assert len(during) == math.ceil(10 * 0.2 * rate / speed - 1e-9)
    assert [shot.time for shot in during] == pytest.approx([i * speed / rate for i in range(len(during))])
    assert [shot.pose[0] for shot in during] == pytest.approx([0.5 * shot.time for shot in during])
    assert len(end) == rate, "the end stays for a second"
    assert {(shot.time, shot.pose[0], shot.moment.step) for shot in end} == {(2.0, 1.0, 10)}
    assert [shot.dynamic_obstacles[0, 0] for shot in shown] == pytest.approx([3.0 - shot.pose[0] for shot in shown])
    assert [shot.dynamic_obstacles[0, 1:].tolist() for shot in shown] == [[1.0, -1.0, 0.0, 0.2, 0.0]] * len(shown)
    for shot in shown:
        assert [pose[0] for pose in shot.path] == pytest.approx([0.1 * i for i in range(shot.moment.step)])


def test_between_two_poses_the_robot_turns_the_short_way():
    before, after = np.array([0.0, 0.0, math.pi - 0.1]), np.array([1.0, 2.0, 0.1 - math.pi])
    assert between(before, after, 0.25) == pytest.approx([0.25, 0.5, math.pi - 0.05])
    assert speeds(before, before + (0.0, 0.0, 0.4 - math.tau), 0.2) == pytest.approx((0.0, 2.0))


def test_speeds_are_those_along_the_robots_way():
    assert speeds(np.array([0.0, 0.0, math.pi / 2]), np.array([0.0, 0.1, math.pi / 2]), 0.2) == pytest.approx((0.5, 0))
    assert speeds(np.zeros(3), np.array([-0.02, 0.0, 0.0]), 0.2) == pytest.approx((-0.1, 0.0))
