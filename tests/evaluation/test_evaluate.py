"""`tb2rl.evaluate`: policies by any name, at a task that they know."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3 import A2C

from tb2rl import evaluate
from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.evaluation.episodes import check_spaces
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve
from tb2rl.simulation.simulator import default_physics
from tb2rl.tasks.wander import Wander

SHORT = {"episodes": 1, "steps": 3, "workers": 1}
KINEMATIC = {**SHORT, "simulation": "kinematic"}


def test_settings_and_simulation_can_be_chosen(trained_run):
    settings = {"world": "circuit", "laser_noise": 0.1}
    evaluation = evaluate(trained_run, settings=settings, **KINEMATIC)
    assert (evaluation.task.world, evaluation.scene.world.name) == ("circuit", "circuit")
    assert evaluation.task.laser_noise == 0.1
    assert (evaluation.simulation, evaluate(trained_run, **SHORT).simulation) == ("kinematic", default_physics().name)
    with pytest.raises(InputError, match="did you mean 'world'"):
        evaluate(trained_run, settings={"wrld": "circuit"}, **KINEMATIC)
    with pytest.raises(InputError, match="unknown simulator 'gazebo'; known: bullet, kinematic"):
        evaluate(trained_run, simulation="gazebo", **SHORT)


def test_the_time_limit_can_be_a_setting(trained_run):
    one = {"settings": {"episode_steps": 3}, "episodes": 1, "simulation": "kinematic"}
    assert evaluate(trained_run, **one).steps == 3
    with pytest.raises(InputError, match=r"steps=.* and task\.episode_steps set the same time limit"):
        evaluate(trained_run, **one, steps=2)


# ---- models that were trained without tb2rl


@pytest.fixture
def make_model():
    """A function that makes an untrained model of Stable-Baselines3 for an environment of Gymnasium's."""
    return lambda **arguments: A2C("MlpPolicy", gym.make("tb2rl:TurtleBot2Maze-v0", **arguments))


@pytest.mark.parametrize(
    ("observation", "task"), [("raw", "maze"), ("discrete", Wander), ("raw", Wander(start_clearance=1.0))]
)
def test_a_model_of_ones_own_is_evaluated_at_a_task(observation, task, make_model, outcomes):
    model = make_model(observation=observation, simulation="kinematic")
    config = resolve("random", settings={"task.observation": observation})
    if isinstance(task, Wander):
        config = config.with_task({"start_clearance": 1.0})
    evaluation = evaluate(model, task=task, **KINEMATIC)
    assert outcomes(evaluation) == outcomes(evaluate(model, config, **KINEMATIC))
    assert evaluation.scene.observation == observation


def test_the_task_of_a_model_of_ones_own_has_settings(make_model):
    known = evaluate("zoo:maze-loop-dqn", task="maze", settings={"world": "circuit"}, **KINEMATIC)
    assert known.task.world == "circuit"
    model = make_model(observation="raw", simulation="kinematic", beams=9)
    evaluation = evaluate(model, task="maze", settings={"beams": 9, "world": "circuit"}, **KINEMATIC)
    assert (evaluation.task.world, evaluation.scene.laser.beams) == ("circuit", 9)
    for observation in (None, "discrete"):
        with pytest.raises(InputError, match="the observation space Box"):
            evaluate(model, task="maze", observation=observation, **KINEMATIC)


def test_the_task_is_named_once(make_model, trained_run):
    with pytest.raises(InputError, match=r"A2C does not come from tb2rl.load or tb2rl.train: pass its task"):
        evaluate(make_model(observation="raw", simulation="kinematic"))
    with pytest.raises(InputError, match=r"object does not come from .*: pass its task, such as task='maze'"):
        evaluate(object())
    with pytest.raises(InputError, match="give one of them"):
        evaluate(trained_run, resolve(), task="maze")
    with pytest.raises(InputError, match="observation= needs task="):
        evaluate(trained_run, observation="raw")


# ---- observations and actions that a policy does not know


@pytest.mark.parametrize("change", [{"beams": 5}, {"range_bins": [1.0]}, {"name": "wall", "world": "wall"}])
def test_observations_that_a_policy_does_not_know_are_refused(trained_run, change):
    with pytest.raises(InputError, match="observation"):
        evaluate(trained_run, settings=change, **KINEMATIC)


def test_actions_that_a_policy_does_not_know_are_refused(cruise):
    policy = make_baseline(resolve("random"))
    for task, space in (("my-maze", r"Discrete\(4\)"), (cruise, r"Box\(-1")):
        with pytest.raises(InputError, match=r"the action space Discrete\(3\), but this task has " + space):
            evaluate(policy, resolve("random", task), **KINEMATIC)


def test_an_image_beside_numbers_is_compared_too():
    scene = make_scene(Wander(observe=("laser", "camera")), "raw")
    known = {**scene.observation_space.spaces, "camera": spaces.Box(0, 255, (1, 64, 65), np.uint8)}
    with pytest.raises(InputError, match="the policy has the observation space"):
        check_spaces(SimpleNamespace(observation_space=spaces.Dict(known)), scene)
    check_spaces(SimpleNamespace(observation_space=scene.observation_space), scene)
    check_spaces(SimpleNamespace(), scene)  # a policy that does not say what it knows
