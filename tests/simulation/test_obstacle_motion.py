"""Dynamic obstacles follow paths, go to random points, and people walk as the social force model says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.obstacles.outlines import COS, SIN, X, Y
from tb2rl.simulation.obstacles.people import social_force
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import parse_dynamic_obstacles

PERIOD = 0.2  # [s]
# By SocialForce of the library PySocialForce 1.1.2, its factor 5.1 divided out: position of the other one
# relative to this one, velocity of this one relative to the other one, and the force.
FORCES = [
    (0.54, -1.86, 0.33, -0.37, 0.023473951456, 0.06684877675),
    (-1.13, -0.23, -1.67, -1.36, 0.042082656769, -0.053111074107),
    (0.76, 1.19, -0.01, 0.68, -0.143313926778, -0.05717276873),
    (0.05, 0.04, 0.43, 0.69, -1.04933143233, -0.009669563117),
    (-0.46, 0.58, -0.77, -0.51, 0.005742830526, -0.035293071887),
]


@pytest.fixture
def walk(make_spec):
    """A function from dynamic obstacles and worlds to their outlines over time, beside standing robots."""

    def walk(dynamic_obstacles, *worlds, steps=100, num_envs=1, seed=0):
        groups = parse_dynamic_obstacles(dynamic_obstacles, "dynamic_obstacles")
        spec = replace(make_spec(*worlds, beams=1), dynamic_obstacles=groups)
        start = InitialState.default(spec, num_envs)
        start.records["obstacle_seed"] = np.random.default_rng(seed).random(num_envs)
        simulation = KinematicSimulator(spec, num_envs)
        states = [simulation.reset(start, np.random.default_rng(0))]
        states += [simulation.step(np.zeros((num_envs, 2)), PERIOD) for _ in range(steps)]
        return np.array([state.dynamic_obstacles for state in states]), states

    return walk


def distances(outlines):
    """Between the centres of all pairs of obstacles [m], shape (steps, num_envs, obstacles, obstacles)."""
    places = outlines[..., [X, Y]]
    return np.linalg.norm(places[:, :, :, None] - places[:, :, None], axis=-1) + 9 * np.eye(places.shape[2])


@pytest.mark.parametrize("case", FORCES, ids=str)
def test_the_social_force_is_that_of_pysocialforce(case):
    assert social_force(*case[:4]) == pytest.approx(case[4:], abs=1e-11)


def test_the_social_force_is_finite_at_the_same_place_and_at_relative_rest():
    assert social_force(0.0, 0.0, 1.0, 0.0) == (0.0, 0.0)
    assert social_force(1.0, 0.0, -0.5, 0.0) == (0.0, 0.0)  # the force has no direction
    assert all(map(math.isfinite, social_force(1e-6, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize("closed", [False, True])
def test_an_obstacle_follows_its_path_at_its_speed_back_and_forth_or_around(closed, walk):
    corners = np.array([(3.0, 3.0), (6.0, 3.0), (6.0, 5.0)])
    route = np.array([*corners, corners[0]] if closed else [*corners, corners[1], corners[0]])
    ends = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))])

    def at(lengths):
        return np.column_stack([np.interp(lengths % ends[-1], ends, column) for column in route.T])

    outlines, _ = walk({"posts": 1, "path": corners.tolist(), "closed": closed, "speed": 0.7}, steps=120)
    places, step, begins = outlines[:, 0, 0, [X, Y]], 0.7 * PERIOD, np.linspace(0, ends[-1], 20001)
    misses = np.linalg.norm(at(begins) - places[0], axis=1) + np.linalg.norm(at(begins + step) - places[1], axis=1)
    expected = at(begins[misses.argmin()] + step * np.arange(121))
    assert np.abs(places - expected).max() < 2e-3  # 2 ends[-1] / 20000


def test_a_box_faces_its_direction_of_motion(walk):
    outlines, _ = walk({"boxes": 1, "path": [[3, 3], [6, 7]], "speed": 0.5}, steps=10)
    assert np.abs(outlines[1:, 0, 0, [COS, SIN]]) == pytest.approx(np.tile((0.6, 0.8), (10, 1)))


def test_the_position_on_a_path_at_the_start_and_the_speed_are_random(walk):
    outlines, _ = walk({"posts": 1, "path": [[3, 3], [7, 3]]}, num_envs=200, steps=1)
    speeds = np.abs(outlines[1] - outlines[0])[:, 0, X] / PERIOD
    assert speeds.max() == pytest.approx(1.0, abs=0.02)
    assert np.quantile(speeds, (0.25, 0.75)) == pytest.approx((0.625, 0.875), abs=0.08)
    assert np.histogram(outlines[0, :, 0, X], 4, (3, 7))[0].min() > 30


@pytest.mark.parametrize(("kind", "world"), [("people", "loop"), ("posts", "maze"), ("boxes", "loop")])
def test_obstacles_move_far_at_their_speed_and_through_no_wall(kind, world, walk):
    group = {kind: 3, "radius": 0.25, "size": [0.4, 0.4], "speed": 0.8}
    outlines, states = walk(group, world, num_envs=8, steps=150)
    places, clearance = outlines[..., [X, Y]], states[0].simulator.spec.worlds[0].clearance
    least = min(clearance(*place) for place in places.reshape(-1, 2))
    assert least > (0.24 if kind == "people" else 0.178)  # where a robot can be, there they may start
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=-1) / PERIOD
    assert (speeds <= 1.3 * 0.8 + 1e-9).all()  # people hurry
    assert np.median(speeds) > 0.8 * 0.8
    assert np.ptp(places, axis=0).max(axis=-1).min() > 1.0, "one of them goes nowhere"


def test_the_corners_of_a_large_box_stay_out_of_walls(walk):
    around = [(10.1 * math.cos(yaw), 10.1 * math.sin(yaw), 0.2, 20.4, yaw) for yaw in np.arange(4) * math.pi / 2]
    hall = World.from_shapes("hall", around, start=(0, 0, 0))
    outlines, _ = walk({"boxes": 1, "size": [3, 3]}, hall, num_envs=30, steps=150)
    cos, sin = np.abs(outlines[..., [COS, SIN]]).T
    assert (np.abs(outlines[..., [X, Y]]).T + 1.5 * (cos + sin)).max() < 10.0


def test_people_walk_around_each_other_and_posts_through_each_other(walk):
    people, _ = walk({"people": 6}, "loop", num_envs=10, steps=200)
    posts, _ = walk({"posts": 6}, "loop", num_envs=10, steps=200)
    assert distances(people).min() > 0.4  # two radii are 0.5: shoulders may brush
    assert distances(posts).min() < 0.2


def test_obstacles_start_away_from_the_robot(walk):
    groups = [{"people": 2, "boxes": 2}, {"posts": 1, "path": [[0, -3], [8, 0]]}]
    outlines, states = walk(groups, num_envs=300, steps=0)
    assert np.linalg.norm(outlines[0][..., [X, Y]] - states[0].pose[:, None, :2], axis=-1).min() > 1.5


def test_whether_people_avoid_the_robot_is_a_setting(walk):
    touched = {}  # share of standing robots that someone runs into within 20 s
    for avoid in (False, True):
        _, states = walk({"people": 4, "avoid_robot": avoid}, "loop", num_envs=200)
        touched[avoid] = np.mean(np.any([state.bumped for state in states], axis=0))
    assert touched[False] > 0.2
    assert touched[True] < 0.1 * touched[False]
