"""Planning on what was seen: a map of the robot's own, which knows a wall once the laser has seen it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.envs.seeded_loop import SeededLoop
from tb2rl.sensors.waypoint import Waypoint
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.tasks.navigate import Navigate
from tb2rl.worlds import World

# A wall from below up to y = 6 m, and the goal behind it.
WORLD = World.from_shapes(
    "wall", [(4.0, 3.0, 0.2, 6.0, 0.0)], start=(2.0, 2.0, 0.0), goal=(6.0, 2.0, 0.0), bounds=(0.0, 0.0, 8.0, 8.0)
)


def scene_of(**settings):
    plain = make_scene(make_task(Navigate, {"world": "maze", "guide": "plan", "beams": 180}), "raw")
    return plain.in_worlds((WORLD,), start="fixed", **settings)


def waypoints(scene, poses):
    """Where the waypoint is, x and y in the world [m], for a robot that is put at one pose after the other."""
    simulation, observation_pipeline = (
        KinematicSimulator(scene.spec),
        scene.observation_pipeline(scene.command_delay()),
    )
    points = []
    for number, pose in enumerate(poses):
        start = scene.task.initial_state(scene.spec.within(0), _One())
        start.pose[:] = pose
        robot_state = simulation.reset(start, np.random.default_rng(0))
        (observation_pipeline.go_on if number else observation_pipeline.begin)(robot_state)
        episode_states = {memory.field: memory for memory in observation_pipeline._memories}
        points.append(replace(robot_state, **episode_states).ahead(1.0)[0])
    return np.array(points)


class _One:
    num_envs = 1

    def uniform(self, count):
        return np.full((1, count), 0.5)


def test_a_planner_that_has_seen_nothing_goes_straight_for_the_goal_and_round_a_wall_once_it_sees_it():
    away, before = (2.0, 2.0, math.pi), (2.0, 2.0, 0.0)
    unseen, *_, seen = waypoints(scene_of(map="online"), [away, *[before] * 7])
    known = waypoints(scene_of(map="known"), [before])[0]
    assert unseen == pytest.approx((3.0, 2.0), abs=0.15), "straight on, where it has not looked yet"
    assert known[1] > 2.7, "the map knows better"
    assert seen[1] > 2.7, "and so does who has looked"


def test_its_map_ends_at_the_bounds_of_its_own_world_however_large_the_others_are():
    narrow = World.from_shapes("narrow", [], start=(0.3, 0.5, 0.0), goal=(4.0, 0.5, 0.0), bounds=(0.0, 0.0, 5.0, 1.0))
    scene = scene_of(map="online").in_worlds((narrow, WORLD), start="fixed")
    (point,) = waypoints(scene, [(1.0, 0.9, 0.0)])
    assert point[1] == pytest.approx(0.5, abs=0.05), "away from the border"


def test_it_forgets_where_an_episode_begins_and_each_robot_has_a_map_of_its_own():
    scene = scene_of(map="online", episode_steps=9)
    batch = SeededLoop.open(scene, "kinematic", 2)
    batch.seed(0)
    first = batch.reset_all().copy()
    actions = np.array([[0.0, 0.0], [-1.0, 1.0]])  # one drives on, one turns
    for _ in range(8):
        later = batch.step_and_reset(actions).observations
    point = [name == "waypoint" for name in scene.observation_space.names]
    assert not np.allclose(later[0, point], later[1, point])
    again = batch.step_and_reset(actions).observations
    np.testing.assert_array_equal(again, first)


def test_a_batch_that_explores_goes_on_from_its_state_to_the_bit():
    scene = scene_of(map="online")
    one, other = SeededLoop.open(scene, "kinematic", 3), SeededLoop.open(scene, "kinematic", 3)
    one.seed(3), other.seed(4)
    one.reset_all(), other.reset_all()
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 3, 2))
    for chosen in actions[:10]:
        one.step_and_reset(chosen)
    other.restore(one.state())
    for chosen in actions[10:]:
        np.testing.assert_array_equal(
            one.step_and_reset(chosen).observations, other.step_and_reset(chosen).observations
        )


def test_a_map_holds_against_beams_that_miss():
    """A tenth of the beams come back empty: as if they had passed the wall."""
    scene = scene_of(map="online", variation={"dropped": 0.1, "laser_noise": 0.03})
    points = waypoints(scene, [(2.0, 2.0, 0.0)] * 31)
    assert (points[6:, 1] > 2.5).all()


def test_the_waypoint_is_said_in_the_robots_frame():
    scene = scene_of(map="known")
    simulation = KinematicSimulator(scene.spec)
    start = scene.task.initial_state(scene.spec.within(0), _One())
    start.pose[:] = 2.0, 7.0, math.pi / 2
    robot_state = simulation.reset(start, np.random.default_rng(0))
    ahead, left = Waypoint(1.0).read(robot_state)[0]
    east, north = robot_state.lookahead_point(1.0)[0] - (2.0, 7.0)
    assert (ahead, left) == pytest.approx((north, -east))
    assert math.hypot(ahead, left) == pytest.approx(1.0, abs=0.01)
