"""Plans on what was seen: a map of the robot's own, which knows a wall once the laser has seen it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.envs.make import make_task
from tb2rl.envs.occupancy_mapper import OccupancyMapper
from tb2rl.envs.scene import make_scene
from tb2rl.sensors.goal import Waypoint
from tb2rl.simulation import InitialState, find_simulator
from tb2rl.tasks.navigate import Navigate
from tb2rl.worlds import World

# A wall from below the map up to y = 6 m, and the goal behind it.
WORLD = World.from_shapes(
    "wall", [(4.0, 2.0, 0.2, 8.0, 0.0)], start=(2.0, 2.0, 0.0), goal=(6.0, 2.0, 0.0), bounds=(0.0, 0.0, 8.0, 8.0)
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


def test_a_map_holds_against_beams_that_miss(make_navigate_scene):
    """A tenth of the beams return nothing, as if they had passed the wall."""
    scene = make_navigate_scene(map="online", variation={"dropped": 0.1, "laser_noise": 0.03})
    poses = [(2.0, 2.0, 0.0), (2.2, 2.0, 0.0)] * 16  # it moves, else it would escape
    assert 0 < sum(np.isinf(robot_state.ranges[0, 90]) for robot_state in robot_states(scene, poses)) < 10
    assert (waypoints(scene, poses)[6:, 1] > 2.5).all()


def test_beams_along_a_thin_wall_do_not_remove_it(make_navigate_scene):
    boxes = [(4.0, 2.0, 0.02, 8.0, 0.0)]
    thin = World.from_shapes("thin", boxes, start=(2.0, 2.0, 0.0), goal=(6.0, 5.0, 0.0), bounds=(0.0, 0.0, 8.0, 8.0))
    looks = [*[(2.0, 5.0, 0.0)] * 7, *[(4.0, 7.5, -math.pi / 2)] * 30]  # at its side, then at its end
    *_, point = waypoints(make_navigate_scene(thin, map="online"), [*looks, (3.2, 5.2, math.pi)])
    assert point[1] > 5.8, "around its end"


@pytest.mark.parametrize(("width", "goes_through"), [(0.34, False), (0.6, True)])
def test_a_gap_is_as_wide_as_the_laser_measures(make_navigate_scene, width, goes_through):
    """Cells are 0.1 m wide, the robot 0.354 m; the other way is 6 m longer."""
    low, high = (4.0, (2.03 - width) / 2, 0.2, 6.03 - width, 0.0), (4.0, 5.615, 0.2, 3.17, 0.0)
    gap = World.from_shapes(
        "gap", [low, high], start=(2.0, 2.0, 0.0), goal=(6.0, 4.0, 0.0), bounds=(0.0, 0.0, 8.0, 8.0)
    )
    *_, point = waypoints(make_navigate_scene(gap, map="online"), [(3.0, 3.9, 0.0)] * 8)
    assert (abs(point[1] - 3.9) < 0.3) == goes_through


def test_a_robot_that_stands_turns_to_where_there_is_room_and_then_plans_again(make_navigate_scene):
    beside_the_wall = (3.7, 2.5, 0.0)  # at y = 2 m both ways would be as long
    points = waypoints(make_navigate_scene(map="online"), [beside_the_wall] * 56)
    assert points[12, 1] < 1.8, "along the wall"
    assert points[30, 0] < 3.5, "away from it, after 1.5 seconds"
    assert points[55] == pytest.approx(points[12], abs=0.1)


def test_a_robot_escapes_from_a_gap_the_way_that_does_not_pass_close_to_its_ends(make_navigate_scene):
    walls = [(1.875, 4.1, 3.75, 0.1, 0.0), (6.175, 4.1, 3.65, 0.1, 0.0)]  # the gap is 0.6 m wide, the robot at its left
    world = World.from_shapes("gap", walls, start=(4.0, 4.0, 1.5), goal=(4.0, 7.0, 0.0), bounds=(0.0, 0.0, 8.0, 8.0))
    points = waypoints(make_navigate_scene(world, map="online"), [(4.0, 4.0, 1.5)] * 30)
    assert points[12, 1] > 4.5, "through the gap"
    assert points[25, 1] < 3.7, "back"


def test_a_robot_without_a_path_forgets_its_map(make_navigate_scene):
    walls = [(2.0, 1.0, 2.2, 0.1, 0.0), (2.0, 3.0, 2.2, 0.1, 0.0), (1.0, 2.0, 0.1, 2.2, 0.0), (3.0, 2.0, 0.1, 2.2, 0.0)]
    room = World.from_shapes("room", walls, start=(2.0, 2.0, 0.0), goal=(6.0, 2.0, 0.0), bounds=(0.0, 0.0, 8.0, 8.0))
    looks = [(2.0, 2.0, angle) for angle in np.linspace(0.0, math.tau, 50)]
    points = waypoints(make_navigate_scene(room, map="online"), looks)
    assert np.isfinite(points).all()
    assert (np.hypot(*(points - (2.0, 2.0)).T) > 0.2).all(), "it always goes somewhere"


def test_the_waypoint_is_observed_in_the_robots_frame(make_navigate_scene):
    (robot_state,) = robot_states(make_navigate_scene(map="known"), [(2.0, 7.0, math.pi / 2)])
    ahead, left = Waypoint(1.0).read(robot_state)[0]
    east, north = robot_state.lookahead_point(1.0)[0] - (2.0, 7.0)
    assert (ahead, left) == pytest.approx((north, -east))
    assert math.hypot(ahead, left) == pytest.approx(1.0, abs=0.01)
