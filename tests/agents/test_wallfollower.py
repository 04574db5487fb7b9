"""The wall follower drives by the latest observation, whatever stands before it."""

from __future__ import annotations

import numpy as np

from tb2rl import make_env
from tb2rl.agents.wallfollower import WallFollower


def test_it_drives_by_the_latest_of_several_frames():
    envs = [make_env("wall", "raw", simulation="kinematic", start="fixed", frames=frames) for frames in (1, 3)]
    rules = [WallFollower(env.observation_space, env.action_space) for env in envs]
    seen = [env.reset(seed=0)[0] for env in envs]
    actions = set()
    for _ in range(200):
        one, other = (int(rule.predict(at)[0]) for rule, at in zip(rules, seen, strict=True))
        assert one == other
        actions.add(one)
        steps = [env.step(one) for env in envs]
        seen = [step[0] for step in steps]
        np.testing.assert_array_equal(seen[0], seen[1][-len(seen[0]) :])
        if steps[0][2] or steps[0][3]:
            break
    assert len(actions) > 1
