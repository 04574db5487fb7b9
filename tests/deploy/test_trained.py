"""A policy drives a robot as it drives in its environment, command for command."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from tb2rl import load, make_env
from tb2rl.core.errors import InputError
from tb2rl.deploy import Driver, Sensed, TrainedPolicy, WorldPlanner
from tb2rl.deploy.description import describe
from tb2rl.deploy.portable.encoding import Encoding
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.sensors import Sensor
from tb2rl.tasks.wander import Wander
from tb2rl.training.training import train

ON_POLICY = {"agent.n_steps": 16, "agent.batch_size": 32, "agent.n_epochs": 1}
OFF_POLICY = {"agent.learning_starts": 64, "agent.buffer_size": 200, "agent.batch_size": 16}
MEMORY = {"agent.policy_kwargs.lstm_hidden_size": 8, "agent.policy_kwargs.n_lstm_layers": 1}
TRAININGS = {
    "frame_stack": ("stable_baselines3:PPO", "maze", {**ON_POLICY, "task.frame_stack": 4}),
    "frames of classes": ("qlearn", "maze", {"task.frame_stack": 2, "task.beams": 5}),
    "normalised": ("stable_baselines3:SAC", "drive", {**OFF_POLICY, "train.norm_obs": True}),
    "recurrent": ("sb3_contrib:RecurrentPPO", "drive", {**ON_POLICY, **MEMORY}),
    "all at once": (
        "sb3_contrib:RecurrentPPO",
        "drive",
        {**ON_POLICY, **MEMORY, "train.norm_obs": True, "task.frame_stack": 3},
    ),
    "to a goal": ("stable_baselines3:PPO", "navigate", {**ON_POLICY, "task.world": "wall"}),
    "by odometry and IMU": (
        "stable_baselines3:PPO",
        "maze",
        {**ON_POLICY, "task.observe": ["laser", "imu", "twist", {"last_action": {"count": 3}}, "bumper", "free_paths"]},
    ),
}
FAST = "all at once"
STEPS = 60


def drive_alike(policy, ask, planner=None, steps=STEPS):
    """Drive the environment of a policy and its driver side by side; returns how many steps they took."""
    env = make_env(policy, simulation="kinematic", variation="none", dynamic_obstacles=None)
    trained = TrainedPolicy(policy)
    observation, _ = env.reset(seed=2)
    driver, remembered = Driver(trained, planner=planner(env) if planner else None), {}
    if trained.needs.goal:
        driver.set_goal(tuple(env.robot_state.goal[0].tolist()))
    driver.start()
    for step in range(steps):
        command = ask(driver, env, step * trained.needs.period)
        action, memory = policy.predict(observation, deterministic=True, **remembered)
        remembered = {} if memory is None else {"state": memory}
        expected = env.scene.actions.commands(env.scene.actions.checked(action))[0]
        assert command.why == "driving"
        assert (command.v, command.w) == pytest.approx(tuple(expected), abs=1e-5)
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            return step + 1
    return steps


@pytest.mark.parametrize(
    "name",
    [
        "maze-loop-ppo",
        "maze-loop-qlearn",
        "wall-wall-dqn",
        pytest.param("maze-loop-turtlebot3-ppo", marks=pytest.mark.slow),
        pytest.param("drive-loop-td3", marks=pytest.mark.slow),
    ],
)
def test_a_policy_of_the_zoo_drives_as_in_its_environment(name, ask):
    assert drive_alike(load(f"zoo:{name}"), ask) == STEPS


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind == FAST else [pytest.mark.slow]) for kind in TRAININGS]
)
def test_frames_statistics_and_memory_come_along(kind, ask, tmp_path):
    agent, task, settings = TRAININGS[kind]
    small = {"task.observation": "raw"} if agent != "qlearn" else {}
    told = {"simulation": "kinematic", "n_envs": 4, "total_timesteps": 128, "eval_freq": 0}
    policy = train(agent, task, settings={**small, **settings}, folder=tmp_path / "run", **told)
    assert drive_alike(policy, ask) >= 2


@pytest.mark.slow
def test_a_policy_that_follows_a_known_plan_drives_as_in_its_environment(ask, tmp_path):
    settings = {**ON_POLICY, "task.guide": "plan", "task.world": "wall", "task.lookahead": 1.2}
    told = {"simulation": "kinematic", "n_envs": 4, "total_timesteps": 128, "eval_freq": 0}
    policy = train("stable_baselines3:PPO", "navigate", settings=settings, folder=tmp_path / "run", **told)
    needs = TrainedPolicy(policy).needs
    assert (needs.goal, needs.lookahead, needs.goal_radius, needs.uses_odometry) == ("plan", 1.2, 0.3, True)
    assert drive_alike(policy, ask, lambda env: WorldPlanner("wall", env.scene.robot.radius)) >= 2


@pytest.mark.parametrize("planner", ["known", "seen"])
def test_a_plan_leads_around_the_wall_to_the_goal(planner, ask):
    config = resolve("pursuit", "navigate", settings={"task.guide": "plan", "task.map": planner, "task.world": "wall"})
    trained = TrainedPolicy(make_baseline(config), config)
    env = make_env(config.task, "raw", simulation="kinematic", start="fixed")
    env.reset(seed=0)
    known = WorldPlanner("wall", env.scene.robot.radius) if planner == "known" else None
    driver = Driver(trained, planner=known)
    assert trained.needs.goal == ("plan" if known else "goal")
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


def test_what_a_policy_needs_is_what_it_was_trained_with():
    needs = TrainedPolicy("zoo:maze-loop-ppo").needs
    assert np.degrees(needs.beams[[0, -1]]).tolist() == [-90.0, 90.0]
    assert (needs.min_range, needs.max_range, needs.period, needs.robot) == (0.1, 30.0, 0.2, "turtlebot2")
    assert (needs.max_speed, needs.max_turn_rate, needs.uses_odometry, needs.goal) == (0.5, 1.0, False, None)
    goal = TrainedPolicy("zoo:wall-wall-qlearn").needs
    assert (goal.goal, goal.goal_radius, goal.uses_odometry) == ("goal", 0.2, True)


class Compass(Sensor):
    """Where the robot truly looks."""

    name, unit = "compass", "rad"
    low, high = -math.pi, math.pi
    bins = (0.0,)

    def read(self, robot_state):
        return robot_state.pose[:, 2:]


@dataclass(frozen=True)
class Wise(Wander):
    """Wander by what no robot senses."""

    def sensors(self, spec):
        return (*super().sensors(spec), Compass())


@pytest.mark.parametrize(
    ("task", "observe", "sentence"),
    [
        (Wise, None, "sensor compass reads the simulation's 'pose', which no robot can sense"),
        ("maze", ["laser", "camera"], "sensor camera reads images, and a driver has none"),
    ],
)
def test_what_no_robot_can_sense_is_refused_in_a_line(task, observe, sentence):
    config = resolve(
        "random", task, settings={"task.observation": "raw", **({"task.observe": observe} if observe else {})}
    )
    with pytest.raises(InputError) as error:
        TrainedPolicy(make_baseline(config), config)
    assert str(error.value) == sentence


def test_a_robot_that_gets_another_goal_on_the_way_knows_what_it_was_told(monkeypatch):
    config = resolve("pursuit", "navigate", settings={"task.world": "wall"})
    policy, seen = make_baseline(config), []
    trained, predict = TrainedPolicy(policy, config), policy.predict
    monkeypatch.setattr(policy, "predict", lambda observation, **_: seen.append(observation) or predict(observation))
    encoding, ranges = Encoding(describe(config, "one")["observation"], trained.needs), np.full(60, 5.0)
    for number, command in enumerate([(0.0, 0.0), (0.3, 0.1), (0.65, 0.2)]):
        if number == 2:
            trained.begin(), encoding.begin()
        sensed = Sensed(ranges, twist=command, goal=(2.0, 0.0), command=command)
        trained.act(sensed)
        told = np.array([command] * 3 if number == 2 else [command, *[(0.0, 0.0)] * 2])
        for each in (seen[-1], encoding(sensed)[0]):
            assert each[-6:] == pytest.approx((told / (0.65, np.pi)).ravel())


def test_a_goal_far_away_fits_on_the_map_that_a_policy_draws():
    config = resolve("pursuit", "navigate", settings={"task.guide": "plan", "task.map": "online", "task.world": "wall"})
    trained = TrainedPolicy(make_baseline(config), config)
    trained.begin()
    v, w = trained.act(Sensed(np.full(len(trained.needs.beams), math.inf), pose=(50.0, -3.0, 0.0), goal=(80.0, -3.0)))
    assert v > 0.3
    assert abs(w) < 0.2
