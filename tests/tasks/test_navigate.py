"""TurtleBot2Navigate: its goals, rewards and observations."""

import math

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.envs.make import make_env, make_task
from tb2rl.envs.scene import make_scene
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.tasks import Commands, Velocities
from tb2rl.tasks.navigate import Navigate

FIVE = {"generator": "mixed", "worlds": 5, "difficulty": 0.5}


def begun(num_envs=200, **settings):
    """A scene, initial states of some episodes in it, and their kinematic simulator."""
    scene = make_scene(make_task("navigate", {"world": FIVE, **settings}), "raw")
    start = scene.task.initial_state(scene.spec, GeneratorSource(np.random.default_rng(0), num_envs))
    return scene, start, KinematicSimulator(scene.spec, num_envs)


def stand(simulator, start, *places):
    """The robot states at other places (num_envs, 2) of the same episodes, heading east."""
    robot_states = []
    for place in places:
        there = InitialState(start.table.copy())
        there.pose[:, :2], there.pose[:, 2] = place, 0.0
        robot_states.append(simulator.reset(there, np.random.default_rng(0)))
    return robot_states


def test_an_episode_leads_from_a_random_pose_to_a_goal_that_can_be_reached():
    _, start, simulator = begun()
    robot_state = simulator.reset(start, np.random.default_rng(0))
    assert (robot_state.path_length < 60).all(), "there is a path"
    assert np.mean(robot_state.path_length) > 3.0
    assert len(np.unique(start.world)) == 5
    assert len(np.unique(start.goal, axis=0)) > 10


def test_with_a_fixed_start_it_leads_from_the_worlds_start_to_the_worlds_goal():
    scene, start, _ = begun(start="fixed")
    worlds = [scene.spec.worlds[int(world)] for world in start.world]
    assert start.pose.tolist() == [list(world.start) for world in worlds]
    assert start.goal.tolist() == [list(world.goal[:2]) for world in worlds]


def test_a_goal_without_a_path_is_refused():
    with pytest.raises(InputError, match=r"the goal \(30, 0\) is outside the bounds"):
        begun(world="loop", goal=(30.0, 0.0))
    with pytest.raises(InputError, match=r"no path for turtlebot2 from start to goal \(4.88, 4.88\)"):
        begun(world="loop", goal=(4.88, 4.88))


def test_progress_is_measured_along_the_path_and_not_the_straight_line():
    scene, start, simulator = begun(world="maze", step_reward=0.0, margin_reward=0.0)
    here = start.pose[:, :2]
    near = scene.spec.goal_paths.lookahead_point(
        start.world.astype(int), start.records["goal_path"].astype(int), here, 0.05
    )
    before, after = stand(simulator, start, here, near)
    forth = scene.task.outcome(before, np.zeros((200, 2)), after)
    back = scene.task.outcome(after, np.zeros((200, 2)), before)
    far = before.path_length > 0.6
    assert (forth.reward[far] > 0.05).all()
    np.testing.assert_allclose(forth.reward[far], -back.reward[far])
    closer = np.hypot(*(before.goal - after.pose[:, :2]).T) < np.hypot(*(before.goal - before.pose[:, :2]).T)
    assert not closer[far].all(), "some paths begin away from the goal"


def test_it_succeeds_within_the_radius_and_fails_at_a_touch():
    scene, start, simulator = begun(num_envs=3, world="loop", goal=(4.0, 4.0))
    (robot_state,) = stand(simulator, start, [(4.0, 3.72), (4.0, 3.68), (4.0, 3.9)])
    robot_state = type(robot_state)(**{**vars(robot_state), "bumped": np.array([False, False, True])})
    outcome = scene.task.outcome(robot_state, np.zeros((3, 2)), robot_state)
    assert outcome.succeeded["goal"].tolist() == [True, False, False]
    assert outcome.failed["collision"].tolist() == [False, False, True]
    assert outcome.reward[[0, 2]].tolist() == [scene.task.goal_reward, scene.task.collision_reward]


def test_it_shows_what_guides_it():
    always = {"laser", "forward speed", "turn rate", "last action"}
    for guide, names in (("goal", {"goal distance", "goal direction", "visited"}), ("plan", {"waypoint"})):
        assert set(begun(guide=guide)[0].observation_space.names) == names | always


def test_actions_are_speeds_or_five_commands():
    assert isinstance(Navigate().actions, Velocities)
    commands = Navigate(named_actions=True).actions
    assert isinstance(commands, Commands)
    assert commands.names == ("forward", "left", "right", "spin_left", "spin_right")
    assert math.isclose(commands.max_speed, Navigate().max_speed)


@pytest.mark.parametrize(("guide", "simulation"), [("goal", "kinematic"), ("plan", "bullet")])
def test_following_the_path_reaches_the_goal_in_both_simulators(guide, simulation):
    env = make_env("navigate", "raw", simulation=simulation, world="maze", start="fixed", guide=guide)
    env.reset(seed=0)
    info = {"ended": ""}
    while not info["ended"]:
        robot_state = env.robot_state
        east, north = (robot_state.lookahead_point(0.6) - robot_state.pose[:, :2])[0]
        off = math.remainder(math.atan2(north, east) - robot_state.pose[0, 2], math.tau)
        action = np.array([1.0 - min(2.0, 3.0 * abs(off)), np.clip(1.5 * off, -1.0, 1.0)])
        info = env.step(action)[-1]
    env.close()
    assert info["ended"] == "goal"
