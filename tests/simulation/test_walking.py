"""Movers go where they are to go: along paths, to random points, and people as the social force model says."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.obstacles.motion import HURRY, SPEED
from tb2rl.simulation.obstacles.outlines import COS, SIN, X, Y
from tb2rl.simulation.obstacles.social_force import social_force
from tb2rl.simulation.spec import OBSTACLE_SEED
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import find_dynamic_obstacles

STEP = 0.2  # [s]
# By SocialForce of the library PySocialForce 1.1.2, its factor 5.1 divided out: where the other one is, from here, the
# velocity of this one less that of the other, and the force.
FORCES = [
    (0.54, -1.86, 0.33, -0.37, 0.023473951456, 0.06684877675),
    (-1.13, -0.23, -1.67, -1.36, 0.042082656769, -0.053111074107),
    (0.76, 1.19, -0.01, 0.68, -0.143313926778, -0.05717276873),
    (0.05, 0.04, 0.43, 0.69, -1.04933143233, -0.009669563117),
    (1.4, -1.19, 1.41, -0.24, 0.004918461189, 0.084438162038),
    (-0.46, 0.58, -0.77, -0.51, 0.005742830526, -0.035293071887),
    (0.08, 1.0, 0.23, 0.0, 0.033183969076, -0.088925376287),
    (0.92, 0.53, 1.36, 0.39, -0.132606056092, -0.42747324191),
]
COMPARE = """
import sys
import numpy as np
from tb2rl.simulation.obstacles.social_force import social_force
import numba
numba.config.DISABLE_JIT = 1  # the library's functions would need SciPy
from pysocialforce import Simulator
rng, worst, compared = np.random.default_rng(0), 0.0, 0
for _ in range(500):
    state = np.column_stack([rng.uniform(-1, 1, (2, 2)), rng.uniform(-1.3, 1.3, (2, 2)), np.ones((2, 2))])
    found = Simulator(state.copy()).forces[1].get_force()[0] / 5.1
    apart, slower = state[0, :2] - state[1, :2], state[1, 2:4] - state[0, 2:4]
    towards = apart / np.hypot(*apart)
    turned = np.arctan2(*(2 * slower + towards)[::-1]) - np.arctan2(*towards[::-1])
    if abs(turned) < np.pi:  # the library takes angles beyond for turns all around
        worst, compared = max(worst, np.abs(found - social_force(*-apart, *-slower)).max()), compared + 1
print(worst, compared)
"""


@pytest.fixture
def walk(make_setup):
    """A function from worlds, movers and steps to their outlines over time, beside standing robots."""

    def walk(dynamic_obstacles, *worlds, steps=100, num_envs=1, seed=0, duration=STEP):
        spec = replace(
            make_setup(*worlds, beams=1),
            dynamic_obstacles=find_dynamic_obstacles(dynamic_obstacles, "dynamic_obstacles"),
        )
        start = InitialState.default(spec, num_envs)
        start.table[:, OBSTACLE_SEED] = np.random.default_rng(seed).random(num_envs)
        twin = KinematicSimulator(spec, num_envs)
        readings = [twin.reset(start, np.random.default_rng(0))]
        readings += [twin.step(np.zeros((num_envs, 2)), duration) for _ in range(steps)]
        return np.array([robot_state.dynamic_obstacles for robot_state in readings]), twin

    return walk


@pytest.mark.parametrize("case", FORCES, ids=str)
def test_the_social_force_is_that_of_pysocialforce(case):
    assert social_force(*case[:4]) == pytest.approx(case[4:], abs=1e-11)


def test_the_social_force_is_that_of_pysocialforce_in_500_random_encounters():
    pytest.importorskip("pysocialforce")
    done = subprocess.run([sys.executable, "-c", COMPARE], capture_output=True, text=True, check=True)
    worst, compared = map(float, done.stdout.split())
    assert worst < 1e-9
    assert compared > 300


def test_two_at_one_place_or_at_rest_to_each_other_are_no_trouble():
    assert social_force(0.0, 0.0, 1.0, 0.0) == (0.0, 0.0)
    assert social_force(1.0, 0.0, -0.5, 0.0) == (0.0, 0.0)  # the force has no direction
    assert all(map(math.isfinite, social_force(1e-6, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize("closed", [False, True])
def test_a_mover_follows_its_path_at_its_speed_there_and_back_or_around(closed, walk):
    corners = np.array([(3.0, 3.0), (6.0, 3.0), (6.0, 5.0)])
    dynamic_obstacles = {"posts": 1, "path": corners.tolist(), "closed": closed, "speed": 0.7}
    way = np.array([*corners, corners[0]] if closed else [*corners, corners[1], corners[0]])
    lengths = np.hypot(*np.diff(way, axis=0).T)
    ends = np.concatenate([[0.0], np.cumsum(lengths)])

    def at(distance):
        distance %= ends[-1]
        leg = np.searchsorted(ends, distance, side="right") - 1
        return way[leg] + (distance - ends[leg]) / lengths[leg] * (way[leg + 1] - way[leg])

    outlines, _ = walk(dynamic_obstacles, steps=120)
    places = outlines[:, 0, 0, [X, Y]]
    begins = np.linspace(0, ends[-1], 20001)
    first = begins[np.argmin([np.hypot(*(at(d) - places[0])) + np.hypot(*(at(d + 0.14) - places[1])) for d in begins])]
    expected = np.array([at(first + 0.7 * STEP * step) for step in range(121)])
    assert np.abs(places - expected).max() < 2e-3  # 2 ends[-1] / 20000


def test_a_box_looks_where_it_goes(walk):
    outlines, _ = walk({"boxes": 1, "path": [[3, 3], [6, 7]], "speed": 0.5}, steps=10)
    assert np.abs(outlines[1:, 0, 0, [COS, SIN]]) == pytest.approx(np.tile((0.6, 0.8), (10, 1)))


def test_where_on_a_path_it_begins_is_drawn_for_each_robot(walk):
    outlines, _ = walk({"posts": 1, "path": [[3, 3], [7, 3]]}, num_envs=200, steps=0)
    begins = outlines[0, :, 0, X]
    assert np.histogram(begins, 4, (3, 7))[0].min() > 30


@pytest.mark.parametrize("kind", ["people", "posts", "boxes"])
@pytest.mark.parametrize("world", ["loop", "maze"])
def test_movers_walk_far_at_their_speed_and_through_no_wall(kind, world, walk):
    outlines, twin = walk({kind: 3, "radius": 0.25, "size": [0.4, 0.4]}, world, num_envs=8, steps=150)
    places, clearance = outlines[..., [X, Y]], twin.spec.worlds[0].clearance
    least = min(clearance(*place) for place in places.reshape(-1, 2))
    assert least > (0.24 if kind == "people" else 0.178)  # where a robot can be, there they may begin
    speeds = np.hypot(*np.moveaxis(np.diff(places, axis=0), -1, 0)) / STEP
    wanted = twin.state()["dynamic_obstacles"]["table"][..., SPEED]
    assert ((wanted >= 0.5) & (wanted <= 1.0)).all()
    assert (speeds <= HURRY * wanted + 1e-9).all()
    assert np.median(speeds / wanted) > 0.8
    assert np.ptp(places, axis=0).max(axis=-1).min() > 1.0, "one of them goes nowhere"


def test_the_corners_of_a_large_box_stay_out_of_walls(walk):
    around = [(10.1 * math.cos(yaw), 10.1 * math.sin(yaw), 0.2, 20.4, yaw) for yaw in np.arange(4) * math.pi / 2]
    hall = World.from_shapes("hall", around, start=(0, 0, 0))
    outlines, _ = walk({"boxes": 1, "size": [3, 3]}, hall, num_envs=30, steps=150)
    cos, sin = np.abs(outlines[..., [COS, SIN]]).T
    assert (np.abs(outlines[..., [X, Y]]).T + 1.5 * (cos + sin)).max() < 10.0


def test_people_walk_around_each_other(walk):
    outlines, _ = walk({"people": 6}, "loop", num_envs=10, steps=200)
    places = outlines[..., [X, Y]]
    apart = np.hypot(*np.moveaxis(places[:, :, :, None] - places[:, :, None], -1, 0)) + 9 * np.eye(6)
    assert apart.min() > 0.4  # two radii are 0.5: shoulders may brush
    through, _ = walk({"posts": 6}, "loop", num_envs=10, steps=200)
    through = through[..., [X, Y]]
    assert (np.hypot(*np.moveaxis(through[:, :, :, None] - through[:, :, None], -1, 0)) + 9 * np.eye(6)).min() < 0.2


def test_where_an_episode_begins_there_is_room_around_the_robot(walk):
    outlines, twin = walk([{"people": 2, "boxes": 2}, {"posts": 1, "path": [[0, -3], [8, 0]]}], num_envs=300, steps=0)
    start = twin.spec.worlds[0].start
    assert np.hypot(*np.moveaxis(outlines[0][..., [X, Y]] - start[:2], -1, 0)).min() > 1.5


def test_each_episode_has_a_crowd_of_its_own_that_its_number_decides(walk):
    first, _ = walk({"people": 2, "posts": 1}, "loop", num_envs=5, seed=3)
    again, _ = walk({"people": 2, "posts": 1}, "loop", num_envs=5, seed=3)
    np.testing.assert_array_equal(first, again)
    assert len(np.unique(first[0, :, 0, X])) == 5
    assert not np.array_equal(first, walk({"people": 2, "posts": 1}, "loop", num_envs=5, seed=4)[0])


def test_whether_people_see_the_robot_is_a_setting(make_setup, start_at):
    run_into = {}  # share of standing robots that someone runs into within 20 s
    for sees in (False, True):
        spec = replace(
            make_setup("loop", beams=1),
            dynamic_obstacles=find_dynamic_obstacles({"people": 4, "avoid_robot": sees}, "dynamic_obstacles"),
        )
        start = InitialState.default(spec, 200)
        start.table[:, OBSTACLE_SEED] = np.random.default_rng(0).random(200)
        twin, touched = KinematicSimulator(spec, 200), np.zeros(200, dtype=bool)
        twin.reset(start, np.random.default_rng(0))
        for _ in range(100):
            touched |= twin.step(np.zeros((200, 2)), STEP).bumped
        run_into[sees] = touched.mean()
    assert run_into[False] > 0.2
    assert run_into[True] < 0.1 * run_into[False]
