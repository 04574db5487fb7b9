"""Plans on what was seen: a map of the robot's own, which knows a wall once the laser has seen it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.envs.episode_state import OccupancyMapper
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.sensors.goal import Waypoint
from tb2rl.simulation import InitialState, find_simulator
from tb2rl.tasks.navigate import Navigate
from tb2rl.worlds import World

# A wall from below up to y = 6 m, and the goal behind it.
WORLD = World.from_shapes(
    "wall", [(4.0, 3.0, 0.2, 6.0, 0.0)], start=(2.0, 2.0, 0.0), goal=(6.0, 2.0, 0.0), bounds=(0.0, 0.0, 8.0, 8.0)
)


@pytest.fixture(scope="module")
def make_navigate_scene():
    """A function from settings to a scene in `WORLD` whose robot plans."""
    plain = make_scene(make_task(Navigate, {"world": "maze", "guide": "plan", "beams": 180}), "raw")
    return lambda *worlds, **settings: plain.in_worlds((*worlds, WORLD), start="fixed", **settings)


def robot_states(scene, poses):
    """Robot states at one pose after the other, with the map if the task maps."""
    simulator = find_simulator("kinematic").open(scene.spec)
    mapper = OccupancyMapper(scene.spec) if scene.task.maps_online else None
    for number, pose in enumerate(poses):
        initial_state = InitialState.default(scene.spec, 1)
        initial_state.pose[:] = pose
        rng = np.random.default_rng(number)
        robot_state = simulator.reset(scene.vary_initial_state(initial_state, rng), rng)
        if mapper is not None:
            mapper.update(robot_state, robot_state.command) if number else mapper.reset(robot_state)
        yield replace(robot_state, occupancy_map=mapper)


def waypoints(scene, poses):
    """The waypoints x, y [m] of a robot at one pose after the other."""
    return np.array([robot_state.lookahead_point(1.0)[0] for robot_state in robot_states(scene, poses)])


def test_a_plan_goes_straight_to_the_goal_until_the_laser_sees_the_wall(make_navigate_scene):
    away, before = (2.0, 2.0, math.pi), (2.0, 2.0, 0.0)
    unseen, *_, seen = waypoints(make_navigate_scene(map="online"), [away, *[before] * 7])
    known = waypoints(make_navigate_scene(map="known"), [before])[0]
    assert unseen == pytest.approx((3.0, 2.0), abs=0.15), "straight on, where it has not looked yet"
    assert known[1] > 2.7, "the known map has the wall"
    assert seen[1] > 2.7, "and so has the robot's own after a look"


def test_its_map_ends_at_the_bounds_of_its_own_world_however_large_the_others_are(make_navigate_scene):
    narrow = World.from_shapes("narrow", [], start=(0.3, 0.5, 0.0), goal=(4.0, 0.5, 0.0), bounds=(0.0, 0.0, 5.0, 1.0))
    (point,) = waypoints(make_navigate_scene(narrow, map="online"), [(1.0, 0.9, 0.0)])
    assert point[1] == pytest.approx(0.5, abs=0.05), "away from the border"


def test_a_map_holds_against_beams_that_miss(make_navigate_scene):
    """A tenth of the beams return nothing, as if they had passed the wall."""
    scene = make_navigate_scene(map="online", variation={"dropped": 0.1, "laser_noise": 0.03})
    poses = [(2.0, 2.0, 0.0)] * 31
    assert 0 < sum(np.isinf(robot_state.ranges[0, 90]) for robot_state in robot_states(scene, poses)) < 10
    assert (waypoints(scene, poses)[6:, 1] > 2.5).all()


def test_the_waypoint_is_observed_in_the_robots_frame(make_navigate_scene):
    (robot_state,) = robot_states(make_navigate_scene(map="known"), [(2.0, 7.0, math.pi / 2)])
    ahead, left = Waypoint(1.0).read(robot_state)[0]
    east, north = robot_state.lookahead_point(1.0)[0] - (2.0, 7.0)
    assert (ahead, left) == pytest.approx((north, -east))
    assert math.hypot(ahead, left) == pytest.approx(1.0, abs=0.01)
