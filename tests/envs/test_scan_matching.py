"""Scan matching: robots whose odometry drifts reach their goals, on a map of their own."""

import numpy as np
import pytest

from tb2rl.envs.control_loop import ControlLoop
from tb2rl.runs import make_baseline, resolve
from tb2rl.simulation import InitialState

WORLDS = {"generator": "offices", "worlds": 4, "size": [16, 16], "difficulty": [0.5, 0.5]}
ERRORS = {"wheel_radius": 1.03, "odometry": [1.0, 1.01], "gyro": 1.01, "mount_yaw": 0.04}


@pytest.mark.parametrize("variation", ["none", ERRORS, {"laser_noise": 0.03, "bias": 0.03, "dropped": 0.05}])
def test_a_robot_reaches_its_goal_however_its_odometry_drifts(variation):
    settings = {"task.guide": "plan", "task.map": "online", "task.variation": variation, "task.start": "fixed"}
    config = resolve("dwa", "navigate", settings={**settings, "task.world": WORLDS, "task.episode_steps": 1500})
    policy, scene, num_envs = make_baseline(config), config.scene, WORLDS["worlds"]
    tables = [InitialState(scene.spec.table[[i]]) for i in range(num_envs)]
    varied = [scene.vary_initial_state(table, np.random.default_rng(i)).table for i, table in enumerate(tables)]
    loop = ControlLoop.open(scene, "kinematic", num_envs)
    observations = loop.reset(InitialState(np.concatenate(varied)), np.random.default_rng(0))
    has_ended, drift, endings = np.zeros(num_envs, dtype=bool), np.zeros(num_envs), set()
    while not has_ended.all():
        transition = loop.step(policy.predict(observations, deterministic=True)[0], has_ended)
        observations = transition.observations
        if (finished := transition.finished) is not None:
            has_ended[finished.indices], endings = True, endings | {str(e) for e in np.ravel(finished.infos["ended"])}
            errors = np.hypot(*(loop.robot_state.odometry - loop.robot_state.pose)[:, :2].T)
            drift[finished.indices] = errors[finished.indices]
    assert endings == {"goal"}
    assert (drift > scene.task.goal_radius).all() == (variation == ERRORS)
