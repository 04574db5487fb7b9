"""A trained policy drives a robot as it drives in its environment, command by command."""

import math
from dataclasses import asdict

import numpy as np
import pytest

from tb2rl import load, make_env
from tb2rl.core.errors import InputError
from tb2rl.deploy import Driver, Scan, SensorData, TrainedPolicy
from tb2rl.deploy.description import describe, find_portable_needs
from tb2rl.deploy.portable.encoding import Encoding
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve
from tb2rl.sensors.motion import Bumper
from tb2rl.training.training import train

STEPS = 60


def ask(driver, env, now):
    """Pass the sensor data of an environment to a driver, and ask it for a command."""
    robot_state, laser = env.robot_state, env.scene.laser
    first, second = laser.angles[:2].tolist()
    driver.see_scan(Scan(robot_state.ranges[0], first, second - first, laser.min_range, laser.max_range), now)
    driver.see_odometry(tuple(robot_state.odometry[0].tolist()), tuple(robot_state.odometry_twist[0].tolist()), now)
    return driver.command(now)


def compare_commands(policy) -> int:
    """Compare the commands of a policy and its driver for an episode; returns the number of steps."""
    env = make_env(policy, simulation="kinematic", variation="none", dynamic_obstacles=None)
    trained = TrainedPolicy(policy)
    observation, _ = env.reset(seed=2)
    driver, memory = Driver(trained, safe="off"), None
    if trained.needs.goal:
        driver.set_goal(tuple(env.robot_state.goal[0].tolist()))
    driver.start()
    for step in range(STEPS):
        command = ask(driver, env, step * trained.needs.period)
        action, memory = policy.predict(observation, state=memory, deterministic=True)
        expected = env.scene.actions.commands(env.scene.actions.checked(action))[0]
        assert command.why == "driving"
        assert (command.v, command.w) == pytest.approx(tuple(expected), abs=1e-5)
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            return step + 1
    return STEPS


@pytest.mark.parametrize("name", ["maze-loop-qlearn", "wall-wall-dqn"])
def test_a_policy_of_the_zoo_drives_as_in_its_environment(name):
    assert compare_commands(load(f"zoo:{name}")) == STEPS


@pytest.mark.slow
def test_frame_stack_statistics_and_recurrent_state_come_along(tmp_path):
    small = {"agent.n_steps": 16, "agent.batch_size": 32, "agent.policy_kwargs.lstm_hidden_size": 8}
    observe = ["laser", "imu", "twist", {"last_action": {"count": 3}}, "bumper", "free_paths"]
    seen = {"task.observation": "raw", "task.observe": observe, "task.frame_stack": 3, "train.norm_obs": True}
    short = {"simulation": "kinematic", "n_envs": 4, "total_timesteps": 128, "eval_freq": 0}
    policy = train("sb3_contrib:RecurrentPPO", "drive", settings=small | seen, folder=tmp_path / "run", **short)
    assert compare_commands(policy) >= 2


def test_a_map_drawn_on_the_robot_leads_around_the_wall_to_the_goal_and_fits_one_far_away():
    config = resolve("pursuit", "navigate", settings={"task.guide": "plan", "task.map": "online", "task.world": "wall"})
    trained = TrainedPolicy(make_baseline(config), config)
    env = make_env(config.task, "raw", simulation="kinematic", start="fixed")
    env.reset(seed=0)
    driver = Driver(trained)
    assert trained.needs.goal == "goal"
    driver.set_goal(tuple(env.robot_state.goal[0].tolist()))
    driver.start()
    ended = ""
    for step in range(600):
        command = ask(driver, env, 0.1 * step)
        if command.why != "driving":
            break
        *_, info = env.step(env.scene.actions.nearest(np.array([command.v, command.w])))
        ended = info["ended"]
    assert (command.why, ended) == ("the goal is reached", "goal")
    trained.reset()
    ranges = np.full(len(trained.needs.beams), math.inf)
    v, w = trained.act(SensorData(ranges, pose=(50.0, -3.0, 0.0), goal=(80.0, -3.0)))
    assert v > 0.3
    assert abs(w) < 0.2


def test_the_needs_of_a_policy_are_those_of_its_training():
    beams, *others = asdict(TrainedPolicy("zoo:maze-loop-ppo").needs).values()
    assert np.degrees(beams[[0, -1]]).tolist() == [-90.0, 90.0]
    assert others == [0.1, 30.0, 0.2, 0.5, 1.0, "turtlebot2", False, None, 0.3, 0.0]
    goal = TrainedPolicy("zoo:wall-wall-qlearn").needs
    assert (goal.goal, goal.goal_radius, goal.uses_odometry) == ("goal", 0.2, True)


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ("bumper", "sensor bumper reads 'pose', which no robot can sense"),
        ("camera", "sensor camera reads images, and a driver has no camera"),
    ],
)
def test_a_sensor_that_no_robot_has_is_refused(sensor, message, monkeypatch):
    monkeypatch.setattr(Bumper, "read", lambda self, robot_state: robot_state.pose[:, 2:])
    config = resolve("random", "maze", settings={"task.observation": "raw", "task.observe": [sensor]})
    with pytest.raises(InputError, match=f"^{message}$"):
        TrainedPolicy(make_baseline(config), config)


def test_a_sensor_reads_the_shortest_range_of_the_scan(monkeypatch):
    nearest = []

    def read(self, robot_state):
        nearest.append(robot_state.nearest_range.tolist())
        return robot_state.bumped[:, None]

    monkeypatch.setattr(Bumper, "read", read)
    config = resolve("random", "maze", settings={"task.observation": "raw", "task.observe": ["bumper"]})
    trained = TrainedPolicy(make_baseline(config), config)
    trained.act(SensorData(np.linspace(0.7, 2.0, len(trained.needs.beams))))
    assert nearest[-1] == [0.7]


def test_a_new_goal_on_the_way_keeps_the_last_commands(monkeypatch):
    config = resolve("pursuit", "navigate", settings={"task.world": "wall"})
    policy, seen = make_baseline(config), []
    trained, predict = TrainedPolicy(policy, config), policy.predict
    monkeypatch.setattr(policy, "predict", lambda observation, **_: seen.append(observation) or predict(observation))
    encoding, ranges = Encoding(describe(config, "one")["observation"], trained.needs), np.full(60, 5.0)
    for number, command in enumerate([(0.0, 0.0), (0.3, 0.1), (0.65, 0.2)]):
        if number == 2:
            trained.reset(), encoding.reset()
        sensed = SensorData(ranges, twist=command, goal=(2.0, 0.0), command=command)
        trained.act(sensed)
        commands = np.array([command] * 3 if number == 2 else [command, *[(0.0, 0.0)] * 2])
        for each in (seen[-1], encoding(sensed)[0]):
            assert each[-6:] == pytest.approx((commands / (0.65, np.pi)).ravel())


def test_a_robot_that_plans_on_its_own_map_can_observe_two_points_of_the_plan():
    observe = ["laser", {"waypoint": {"lookahead": 0.6}}, "waypoint_bearing"]
    settings = {"task.guide": "plan", "task.observe": observe, "task.map": "online"}
    config = resolve("random", "navigate", settings=settings)
    assert TrainedPolicy(make_baseline(config), config).needs.goal == "goal"
    message = "^the sensors read 2 points of a plan, and a driver has only one$"
    with pytest.raises(InputError, match=message):
        find_portable_needs(config)  # another program must plan
    known = resolve("random", "navigate", settings=settings | {"task.map": "known"})
    with pytest.raises(InputError, match=message):
        TrainedPolicy(make_baseline(known), known)
