"""Robots among things that move: both simulations have the same ones, see and feel them alike, and go on to the bit."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import Start, simulate
from tb2rl.simulation.kinematic import KinematicSimulation
from tb2rl.simulation.outlines import COS, LENGTH, SIN, WIDTH, X, Y
from tb2rl.simulation.setup import CROWD
from tb2rl.simulation.walking import NEXT, SPEED, STRIDE
from tb2rl.worlds.movers import find_movers
from tb2rl.worlds.world import World

STEP = 0.2  # [s]
KINDS = [
    {"people": 4},
    {"people": 4, "avoid_robot": True},
    {"posts": 4, "radius": 0.15},
    {"boxes": 4, "size": [0.6, 0.3]},
    [{"posts": 5, "path": [[-4, -4], [-4, 4], [4, 4]]}, {"boxes": 3, "path": [[4, 4], [4, -4]], "closed": True}],
]
MIXED = [{"people": 2, "boxes": 1}, {"posts": 1, "path": [[-4, -4], [-4, 4]]}]
GRAZING = 5e-3  # [m] within which of an edge a beam may be taken to pass or to hit


def among(setup, movers):
    return replace(setup, movers=find_movers(movers, "movers"))


def begin(setup, rng, robots=1, clearance=0.3):
    """Starts anywhere, with a number for the movers each."""
    worlds = rng.integers(len(setup.worlds), size=robots)
    start = Start.proposed(setup, robots, worlds)
    start.pose[:] = setup.poses_from(worlds, rng.random((robots, 4)), clearance)
    start.table[:, CROWD] = rng.random(robots)
    return start


def drives(rng, steps=25):
    """Commands of a random drive: another one each second, mostly ahead."""
    told = np.column_stack([rng.uniform(-0.1, 0.6, steps // 5), rng.uniform(-1.5, 1.5, steps // 5)])
    return np.repeat(told, 5, axis=0)[:, None]


def gap(outlines, pose):
    """Distance of a pose from each mover (movers, 6) [m]."""
    east, north = (pose[:2] - outlines[:, [X, Y]]).T
    along = np.abs(outlines[:, COS] * east + outlines[:, SIN] * north)
    across = np.abs(outlines[:, COS] * north - outlines[:, SIN] * east)
    box = np.hypot(np.maximum(along - outlines[:, LENGTH], 0), np.maximum(across - outlines[:, WIDTH], 0))
    return np.where(outlines[:, WIDTH] > 0, box, np.hypot(east, north) - outlines[:, LENGTH])


def grazes(outlines, pose, angles):
    """Whether each beam passes or hits a mover close to an edge, where rounding decides."""
    near = np.zeros(len(angles), dtype=bool)
    for row in outlines:
        corners = [(0.0, 0.0)] if row[WIDTH] == 0 else [(a, b) for a in (1, -1) for b in (1, -1)]
        for a, b in corners:
            east = row[X] + a * row[LENGTH] * row[COS] - b * row[WIDTH] * row[SIN] - pose[0]
            north = row[Y] + a * row[LENGTH] * row[SIN] + b * row[WIDTH] * row[COS] - pose[1]
            across = np.abs(np.cos(pose[2] + angles) * north - np.sin(pose[2] + angles) * east)
            near |= np.abs(across - (row[LENGTH] if row[WIDTH] == 0 else 0.0)) < GRAZING
    return near


def ray_errors(bullet, reading):
    """How far from what the laser sees PyBullet's own rays end [m], for beams that graze no mover.

    A ray of PyBullet ends as soon as it is within 1 mm of what is round, long before, if it comes in at a small angle:
    so what counts is how far from the surface it ends.
    """
    pose, angles, movers = reading.pose[0], bullet.setup.laser.angles, reading.movers[0]
    reach = bullet.setup.laser.max_range
    found = np.minimum(bullet.ray_ranges(pose, angles), reach)
    errors = np.abs(found - np.minimum(reading.ranges[0], reach))
    ends = pose[:2] + found[:, None] * np.column_stack([np.cos(pose[2] + angles), np.sin(pose[2] + angles)])
    errors = np.minimum(errors, [np.abs(gap(movers, end)).min() for end in ends])
    return errors[~grazes(movers, pose, angles)]


# ---- both simulations


@pytest.mark.parametrize("movers", KINDS, ids=str)
def test_twin_and_physics_stay_together_until_the_first_touch(movers, make_setup, make_bullet):
    setup = among(make_setup("loop", "maze", beams=36), movers)
    bullet, twin, rng = make_bullet(setup), KinematicSimulation(setup), np.random.default_rng(0)
    parted, rays, ends = [], [], []
    for _ in range(40):
        start = begin(setup, rng)
        for simulation in (bullet, twin):
            simulation.reset(Start(start.table.copy()), np.random.default_rng(0))
        for told in drives(rng):
            real, fast = bullet.step(told, STEP), twin.step(told, STEP)
            if real.bumped[0] or fast.bumped[0]:
                ends.append((bool(real.moving[0]), bool(fast.moving[0])))
                break
            seen = 1e-9 if "avoid_robot" not in str(movers) else 0.05
            assert np.abs(real.movers - fast.movers).max() < seen, "the same movers, unless they see the robot"
            east, north, turn = (real.pose - fast.pose)[0]
            parted.append((math.hypot(east, north), abs(math.remainder(turn, math.tau))))
            rays.extend(ray_errors(bullet, real))
    distance, turn = np.median(parted, axis=0)
    assert distance < 0.03
    assert math.degrees(turn) < 3
    assert len(parted) > 700
    assert np.mean(np.array(rays) > 1.01e-3) < 1e-3, "walls' edges are grazed, too"
    assert sum(real == fast for real, fast in ends) >= 0.9 * len(ends)
    assert any(real for real, _ in ends) or "avoid_robot" in str(movers)


def test_without_movers_a_reading_says_nothing_of_them(make_setup, make_bullet):
    setup = make_setup("loop", beams=9)
    for simulation in (make_bullet(setup), KinematicSimulation(setup)):
        reading = simulation.reset(Start.proposed(setup, 1), np.random.default_rng(0))
        assert reading.movers is None
        assert reading.moving is None
        assert "movers" not in reading.state()


def test_worlds_have_movers_of_their_own_beside_those_of_the_task(make_setup):
    own = World.from_shapes("own", start=(0, 0, 0), bounds=(-9, -9, 9, 9), movers=find_movers({"posts": 2}, ""))
    bare = World.from_shapes("bare", start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    setup = among(make_setup(bare, own), {"people": 1})
    twin = KinematicSimulation(setup, 2)
    reading = twin.reset(Start.proposed(setup, 2, np.array([0, 1])), np.random.default_rng(0))
    assert ((reading.movers[..., LENGTH] > 0).sum(axis=1) == (1, 3)).all()
    assert (reading.movers[0, 1:, [LENGTH, WIDTH]] == 0).all()


def test_a_group_is_there_in_its_share_of_the_episodes_all_of_it_or_nobody(make_setup, make_bullet):
    groups = [{"people": 3, "presence": 0.25}, {"posts": 1}, {"boxes": 2, "presence": 0.8}]
    setup, rng = among(make_setup("loop", "maze", beams=9), groups), np.random.default_rng(3)
    twin, start = KinematicSimulation(setup, 2000), begin(setup, rng, 2000)
    there = twin.reset(start, rng).movers[..., LENGTH] > 0
    assert (there[:, :3] == there[:, [0]]).all() & there[:, 3].all() & (there[:, 4] == there[:, 5]).all()
    both = [np.mean(there[:, 0]), np.mean(there[:, 4]), np.mean(there[:, 0] & there[:, 4])]
    assert both == pytest.approx([0.25, 0.8, 0.2], abs=0.03)
    twin.step(np.zeros((2000, 2)), STEP)
    again = KinematicSimulation(setup, 2000)
    again.restore(twin.state())
    step = np.full((2000, 2), 0.2)
    assert (again.step(step, STEP).movers == twin.step(step, STEP).movers).all()
    for lone in (0, int(there[:, 0].argmax())):
        one = Start(start.table[[lone]].copy())
        assert (make_bullet(setup).reset(one, rng).movers[0, :, LENGTH] > 0).tolist() == there[lone].tolist()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_depth_images_show_what_moves(name, make_setup):
    """A post of 0.3 m stands across: the row of pixels at the camera's height sees its front."""
    path = {"posts": 1, "radius": 0.3, "path": [[2, -1e-3], [2, 1e-3]], "speed": 1e-3}
    setup = among(make_setup(World.from_shapes("floor", start=(0, 0, 0), bounds=(-9, -9, 9, 9))), path)
    simulation = simulate(name, setup)
    reading = simulation.reset(Start.proposed(setup, 1), np.random.default_rng(0))
    depth = reading.look(64, 48)[1][0]
    simulation.close()
    camera = ROBOT.camera.position[0]
    assert depth[23, 32] == pytest.approx(2.0 - camera - 0.3, abs=0.01)
    assert not math.isclose(depth[23, 2], depth[23, 32], abs_tol=0.5)


# ---- touches


def standing_in_the_way(make_setup, name, kind="posts"):
    """A robot that stands at (0, 0), and a mover that comes along the x axis from 2 m off, at 1 m/s."""
    along = {kind: 1, "size": [0.5, 0.4], "path": [[2, 0], [-2, 0]], "speed": 1.0}
    setup = among(make_setup(World.from_shapes("floor", start=(0, 0, 0), bounds=(-9, -9, 9, 9)), beams=9), along)
    simulation, start = simulate(name, setup), Start.proposed(setup, 1)
    return simulation, simulation.reset(start, np.random.default_rng(0))


@pytest.mark.parametrize("kind", ["posts", "boxes"])
@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_what_runs_into_a_standing_robot_touches_it_and_stops_without_pushing(name, kind, make_setup):
    simulation, reading = standing_in_the_way(make_setup, name, kind)
    readings = [simulation.step(np.zeros((1, 2)), STEP) for _ in range(30)]
    touched = [bool(reading.bumped[0]) for reading in readings]
    first = touched.index(True)
    assert 2 < first < 25
    assert all(touched[first:])
    assert all(reading.moving[0] for reading in readings[first:])
    assert np.hypot(*readings[-1].pose[0, :2]) < 2e-3
    assert gap(readings[-1].movers[0], readings[-1].pose[0]) - ROBOT.radius == pytest.approx(0.002, abs=1e-3)
    assert reading.movers.shape == (1, 1, 6)
    assert np.hypot(*reading.movers[0, 0, :2]) > 1.5, "earlier readings keep what they show"
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_what_waits_goes_on_when_the_robot_has_gone(name, make_setup):
    simulation, _ = standing_in_the_way(make_setup, name)
    while not (reading := simulation.step(np.zeros((1, 2)), STEP)).bumped[0]:
        pass
    side = np.sign(reading.movers[0, 0, X])
    for _ in range(10):  # to the left and a little away from it
        simulation.step(np.array([[0.0, (math.pi / 2 + 0.5 * side) / 2]]), STEP)
    for _ in range(10):
        reading = simulation.step(np.array([[0.5, 0.0]]), STEP)
    assert abs(reading.pose[0, 1]) > 0.6
    for _ in range(5):
        reading = simulation.step(np.zeros((1, 2)), STEP)
    assert np.sign(reading.movers[0, 0, X]) == -side
    assert not reading.bumped[0]
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_a_robot_that_drives_into_something_slower_stops_at_it(name, make_setup):
    path = {"posts": 1, "path": [[2, -1e-3], [2, 1e-3]], "speed": 1e-3}
    setup = among(make_setup(World.from_shapes("floor", start=(0, 0, 0), bounds=(-9, -9, 9, 9)), beams=9), path)
    simulation = simulate(name, setup)
    simulation.reset(Start.proposed(setup, 1), np.random.default_rng(0))
    for _ in range(25):
        reading = simulation.step(np.array([[0.5, 0.0]]), STEP)
    assert reading.bumped[0]
    assert reading.moving[0]
    assert reading.pose[0, 0] == pytest.approx(2 - 0.25 - ROBOT.radius, abs=5e-3)
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_a_wall_that_is_touched_is_nothing_that_moves(name, make_setup):
    wall = [(1.0, 0.0, 0.2, 4.0, 0.0)]
    far = {"posts": 1, "path": [[-6, -6], [-6, 6]]}
    world = World.from_shapes("wall", wall, start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    setup = among(make_setup(world, beams=9), far)
    simulation = simulate(name, setup)
    simulation.reset(Start.proposed(setup, 1), np.random.default_rng(0))
    for _ in range(15):
        reading = simulation.step(np.array([[0.5, 0.0]]), STEP)
    assert reading.bumped[0]
    assert not reading.moving[0]
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_a_wall_that_is_touched_counts_although_something_touches_the_robot_from_behind(name, make_setup):
    wall = World.from_shapes("wall", [(1.0, 0.0, 0.2, 4.0, 0.0)], start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    post = {"posts": 1, "path": [[-3, 0], [0.8, 0]], "speed": 0.6}  # it comes back once the robot is at the wall
    setup = among(make_setup(wall, beams=9), post)
    simulation = simulate(name, setup)
    simulation.reset(Start.proposed(setup, 1), np.random.default_rng(0))
    moving = []
    for _ in range(100):
        reading = simulation.step(np.array([[0.2, 0.0]]), STEP)
        behind = gap(reading.movers[0], reading.pose[0])[0] < ROBOT.radius + 5e-3
        if behind and reading.bumped[0]:
            moving.append(bool(reading.moving[0]))
    assert len(moving) > 5
    assert not any(moving)
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_what_is_far_off_goes_at_its_speed_while_the_robot_is_at_a_wall(name, make_setup):
    wall = World.from_shapes("wall", [(0.3, 0.0, 0.2, 4.0, 0.0)], start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    far = {"boxes": 1, "path": [[-6, -100], [-6, 100]], "speed": 0.5}
    setup = among(make_setup(wall, beams=9), far)
    simulation = simulate(name, setup)
    before = simulation.reset(Start.proposed(setup, 1), np.random.default_rng(0)).movers
    for _ in range(5):
        reading = simulation.step(np.array([[0.5, 0.0]]), STEP)
    assert reading.bumped[0]
    assert np.abs(reading.movers - before)[0, 0, Y] == pytest.approx(0.5 * 5 * STEP)
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
@pytest.mark.parametrize("ahead", ["post", "wall"])
def test_what_is_nearest_along_the_beams_is_told_apart(name, ahead, make_setup):
    """A post in sight at 1.25 m, a wall behind the robot's back at 0.5 m, and one ahead at 1 m or at 3 m."""
    path = {"posts": 1, "path": [[1.5, -1e-3], [1.5, 1e-3]], "speed": 1e-3}
    walls = [(-0.6, 0.0, 0.2, 4.0, 0.0), (3.1 if ahead == "post" else 1.1, 0.0, 0.2, 4.0, 0.0)]
    world = World.from_shapes("walls", walls, start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    setup = among(make_setup(world, beams=5, field_of_view=1.0), path)
    simulation = simulate(name, setup)
    reading = simulation.reset(Start.proposed(setup, 1), np.random.default_rng(0))
    assert reading.moving.tolist() == [ahead == "post"]
    assert reading.nearest[0] == pytest.approx(1.25 if ahead == "post" else 1.0, abs=1e-3)
    simulation.close()


# ---- going on to the bit


def recorded(simulation, told):
    """All that readings of a drive say, to compare to the bit."""
    rows = [simulation.step(each, STEP).state() for each in told]
    return [{name: np.asarray(value).tobytes() for name, value in row.items()} for row in rows]


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
@pytest.mark.parametrize("movers", [MIXED, {"people": 3, "avoid_robot": True}], ids=["mixed", "seeing"])
def test_states_and_copies_go_on_to_the_bit(name, movers, make_setup):
    setup, rng = among(make_setup("loop", beams=9, noise=0.01), movers), np.random.default_rng(1)
    simulation, told = simulate(name, setup), [*drives(rng, 30)]
    simulation.reset(begin(setup, rng), np.random.default_rng(0))
    recorded(simulation, told[:15])
    copies = [copy.deepcopy(simulation), pickle.loads(pickle.dumps(simulation))]
    expected = recorded(simulation, told)
    for each in copies:
        assert recorded(each, told) == expected
        each.close()
    state = simulation.state()
    expected = recorded(simulation, told)
    simulation.reset(begin(setup, rng), np.random.default_rng(0))
    recorded(simulation, told)
    other = simulate(name, setup)
    other.reset(begin(setup, rng), np.random.default_rng(0))
    for each in (simulation, other):
        each.restore(pickle.loads(pickle.dumps(state)))
        assert recorded(each, told) == expected
        each.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
@pytest.mark.parametrize("seed", range(3))
def test_the_same_start_gives_the_same_episode_whatever_was_before(name, seed, make_setup):
    setup, rng = among(make_setup("loop", beams=9), [*MIXED, {"posts": 4}]), np.random.default_rng(seed)
    start, told = begin(setup, rng), [*drives(rng, 40)]
    episodes = []
    for before in range(3):
        simulation = simulate(name, setup)
        for _ in range(before):
            simulation.reset(begin(setup, rng), np.random.default_rng(0))
            recorded(simulation, drives(rng, 10))
        simulation.reset(Start(start.table.copy()), np.random.default_rng(0))
        episodes.append(recorded(simulation, told))
        simulation.close()
    assert episodes[0] == episodes[1] == episodes[2]


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_a_state_of_people_on_an_open_floor_goes_on(name, make_setup):
    setup = among(make_setup(beams=9), {"people": 2})
    simulation = simulate(name, setup)
    simulation.reset(Start.proposed(setup, 1), np.random.default_rng(0))
    recorded(simulation, [*drives(np.random.default_rng(0), 5)])
    state = simulation.state()
    told = [*drives(np.random.default_rng(1), 10)]
    expected = recorded(simulation, told)
    simulation.restore(state)
    assert recorded(simulation, told) == expected
    simulation.close()


def test_robots_that_begin_anew_leave_the_others_and_their_movers_alone(make_setup):
    setup, rng = among(make_setup("loop", "maze", beams=9, noise=0.01), MIXED), np.random.default_rng(1)
    start, anew = begin(setup, rng, 20), np.array([0, 3, 11])
    runs, told = [], rng.uniform((-0.1, -1), (0.6, 1), (20, 20, 2))
    for restarting in (False, True):
        twin = KinematicSimulation(setup, 20)
        twin.reset(Start(start.table.copy()), np.random.default_rng(0))
        for each in told[:10]:
            reading = twin.step(each, STEP)
        if restarting:
            fresh = begin(setup, np.random.default_rng(5), 3)
            reading, first = twin.restart(anew, fresh, reading)
            np.testing.assert_array_equal(first.movers, reading.movers[anew])
            np.testing.assert_array_equal(first.moving, reading.moving[anew])
            np.testing.assert_array_equal(first.ranges, reading.ranges[anew])
            beginner = KinematicSimulation(setup, 3).reset(fresh, np.random.default_rng(0))
            np.testing.assert_array_equal(first.movers, beginner.movers)
        runs.append([twin.step(each, STEP) for each in told[10:]])
    others = np.setdiff1d(np.arange(20), anew)
    for without, with_restart in zip(*runs, strict=True):
        for name in ("pose", "ranges", "movers", "moving"):
            np.testing.assert_array_equal(getattr(without, name)[others], getattr(with_restart, name)[others])


def test_threads_and_the_number_of_robots_change_nothing(make_setup, monkeypatch):
    setup, rng = among(make_setup("loop", beams=9), MIXED), np.random.default_rng(1)
    start, told = begin(setup, rng, 64), rng.uniform((-0.1, -1), (0.6, 1), (10, 64, 2))
    ends = []
    for worth, robots in ((0.0, 64), (1e9, 64), (1e9, 7)):
        monkeypatch.setattr("tb2rl.simulation.kinematic.WORTH_THREADS", worth)
        monkeypatch.setattr("tb2rl.simulation.kinematic.WAKING", 0.0)
        twin = KinematicSimulation(setup, robots)
        twin.reset(Start(start.table[:robots].copy()), np.random.default_rng(0))
        for each in told:
            reading = twin.step(each[:robots], STEP)
        ends.append((reading.pose[:7], reading.movers[:7], reading.ranges[:7]))
    for each in ends[1:]:
        for one, other in zip(ends[0], each, strict=True):
            np.testing.assert_array_equal(one, other)


def worse(state, change):
    state = copy.deepcopy(state)
    change(state["movers"]["table"])
    return state


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.__setitem__((0, 0, X), np.nan),
        lambda table: table.__setitem__((0, 0, LENGTH), 3.0),
        lambda table: table.__setitem__((0, 0, SPEED), 1e6),
        lambda table: table.__setitem__((0, 3, NEXT), 1e9),
        lambda table: table.__setitem__((0, 3, NEXT), -1.0),
        lambda table: table.__setitem__((0, 3, STRIDE), 7.0),
    ],
)
def test_a_state_of_other_movers_is_refused(name, change, make_setup):
    setup = among(make_setup("loop", beams=9), MIXED)
    simulation = simulate(name, setup)
    simulation.reset(begin(setup, np.random.default_rng(0)), np.random.default_rng(0))
    state = simulation.state()
    with pytest.raises(ValueError, match="mover"):
        simulation.restore(worse(state, change))
    with pytest.raises(ValueError, match="mover"):
        simulation.restore({**state, "movers": {**state["movers"], "table": state["movers"]["table"][:, :2]}})
    simulation.restore(state)
    simulation.close()


def test_a_robot_out_of_reach_of_all_movers_drives_to_the_bit_as_one_alone(make_setup):
    world = World.from_shapes("floor", start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    far, told = (
        {"boxes": 2, "path": [[-8, -8], [-8, 8]]},
        np.random.default_rng(0).uniform((-0.3, -2), (0.6, 2), (40, 2)),
    )
    poses = []
    for setup in (make_setup(world, beams=9), among(make_setup(world, beams=9), far)):
        twin = KinematicSimulation(setup)
        twin.reset(Start.proposed(setup, 1), np.random.default_rng(0))
        poses.append([twin.step(each[None], STEP).pose for each in told])
    np.testing.assert_array_equal(*poses)
