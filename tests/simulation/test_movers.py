"""Robots among things that move: both simulations have the same ones, see and feel them alike, and go on to the bit."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, simulate
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.obstacles.motion import NEXT, SPEED, STRIDE
from tb2rl.simulation.obstacles.outlines import COS, LENGTH, SIN, WIDTH, X, Y
from tb2rl.simulation.spec import OBSTACLE_SEED
from tb2rl.worlds.dynamic_obstacles import find_dynamic_obstacles
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


def among(spec, dynamic_obstacles):
    return replace(spec, dynamic_obstacles=find_dynamic_obstacles(dynamic_obstacles, "dynamic_obstacles"))


def begin(spec, rng, num_envs=1, clearance=0.3):
    """Starts anywhere, with a number for the movers each."""
    worlds = rng.integers(len(spec.worlds), size=num_envs)
    start = InitialState.default(spec, num_envs, worlds)
    start.pose[:] = spec.poses_from(worlds, rng.random((num_envs, 4)), clearance)
    start.table[:, OBSTACLE_SEED] = rng.random(num_envs)
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


def ray_errors(bullet, robot_state):
    """How far from what the laser sees PyBullet's own rays end [m], for beams that graze no mover.

    A ray of PyBullet ends as soon as it is within 1 mm of what is round, long before, if it comes in at a small angle:
    so what counts is how far from the surface it ends.
    """
    pose, angles, dynamic_obstacles = robot_state.pose[0], bullet.spec.laser.angles, robot_state.dynamic_obstacles[0]
    reach = bullet.spec.laser.max_range
    found = np.minimum(bullet.ray_ranges(pose, angles), reach)
    errors = np.abs(found - np.minimum(robot_state.ranges[0], reach))
    ends = pose[:2] + found[:, None] * np.column_stack([np.cos(pose[2] + angles), np.sin(pose[2] + angles)])
    errors = np.minimum(errors, [np.abs(gap(dynamic_obstacles, end)).min() for end in ends])
    return errors[~grazes(dynamic_obstacles, pose, angles)]


# ---- both simulations


@pytest.mark.parametrize("dynamic_obstacles", KINDS, ids=str)
def test_twin_and_physics_stay_together_until_the_first_touch(dynamic_obstacles, make_setup, make_bullet):
    spec = among(make_setup("loop", "maze", beams=36), dynamic_obstacles)
    bullet, twin, rng = make_bullet(spec), KinematicSimulator(spec), np.random.default_rng(0)
    parted, rays, ends = [], [], []
    for _ in range(40):
        start = begin(spec, rng)
        for simulation in (bullet, twin):
            simulation.reset(InitialState(start.table.copy()), np.random.default_rng(0))
        for told in drives(rng):
            real, fast = bullet.step(told, STEP), twin.step(told, STEP)
            if real.bumped[0] or fast.bumped[0]:
                ends.append((bool(real.nearest_is_dynamic[0]), bool(fast.nearest_is_dynamic[0])))
                break
            seen = 1e-9 if "avoid_robot" not in str(dynamic_obstacles) else 0.05
            assert np.abs(real.dynamic_obstacles - fast.dynamic_obstacles).max() < seen, (
                "the same movers, unless they see the robot"
            )
            east, north, turn = (real.pose - fast.pose)[0]
            parted.append((math.hypot(east, north), abs(math.remainder(turn, math.tau))))
            rays.extend(ray_errors(bullet, real))
    distance, turn = np.median(parted, axis=0)
    assert distance < 0.03
    assert math.degrees(turn) < 3
    assert len(parted) > 700
    assert np.mean(np.array(rays) > 1.01e-3) < 1e-3, "walls' edges are grazed, too"
    assert sum(real == fast for real, fast in ends) >= 0.9 * len(ends)
    assert any(real for real, _ in ends) or "avoid_robot" in str(dynamic_obstacles)


def test_without_movers_a_reading_says_nothing_of_them(make_setup, make_bullet):
    spec = make_setup("loop", beams=9)
    for simulation in (make_bullet(spec), KinematicSimulator(spec)):
        robot_state = simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
        assert robot_state.dynamic_obstacles is None
        assert robot_state.nearest_is_dynamic is None
        assert "dynamic_obstacles" not in robot_state.state()


def test_worlds_have_movers_of_their_own_beside_those_of_the_task(make_setup):
    own = World.from_shapes(
        "own", start=(0, 0, 0), bounds=(-9, -9, 9, 9), dynamic_obstacles=find_dynamic_obstacles({"posts": 2}, "")
    )
    bare = World.from_shapes("bare", start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    spec = among(make_setup(bare, own), {"people": 1})
    twin = KinematicSimulator(spec, 2)
    robot_state = twin.reset(InitialState.default(spec, 2, np.array([0, 1])), np.random.default_rng(0))
    assert ((robot_state.dynamic_obstacles[..., LENGTH] > 0).sum(axis=1) == (1, 3)).all()
    assert (robot_state.dynamic_obstacles[0, 1:, [LENGTH, WIDTH]] == 0).all()


def test_a_group_is_there_in_its_share_of_the_episodes_all_of_it_or_nobody(make_setup, make_bullet):
    groups = [{"people": 3, "presence": 0.25}, {"posts": 1}, {"boxes": 2, "presence": 0.8}]
    spec, rng = among(make_setup("loop", "maze", beams=9), groups), np.random.default_rng(3)
    twin, start = KinematicSimulator(spec, 2000), begin(spec, rng, 2000)
    there = twin.reset(start, rng).dynamic_obstacles[..., LENGTH] > 0
    assert (there[:, :3] == there[:, [0]]).all() & there[:, 3].all() & (there[:, 4] == there[:, 5]).all()
    both = [np.mean(there[:, 0]), np.mean(there[:, 4]), np.mean(there[:, 0] & there[:, 4])]
    assert both == pytest.approx([0.25, 0.8, 0.2], abs=0.03)
    twin.step(np.zeros((2000, 2)), STEP)
    again = KinematicSimulator(spec, 2000)
    again.restore(twin.state())
    step = np.full((2000, 2), 0.2)
    assert (again.step(step, STEP).dynamic_obstacles == twin.step(step, STEP).dynamic_obstacles).all()
    for lone in (0, int(there[:, 0].argmax())):
        one = InitialState(start.table[[lone]].copy())
        assert (make_bullet(spec).reset(one, rng).dynamic_obstacles[0, :, LENGTH] > 0).tolist() == there[lone].tolist()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_depth_images_show_what_moves(name, make_setup):
    """A post of 0.3 m stands across: the row of pixels at the camera's height sees its front."""
    path = {"posts": 1, "radius": 0.3, "path": [[2, -1e-3], [2, 1e-3]], "speed": 1e-3}
    spec = among(make_setup(World.from_shapes("floor", start=(0, 0, 0), bounds=(-9, -9, 9, 9))), path)
    simulation = simulate(name, spec)
    robot_state = simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    depth = robot_state.render_camera(64, 48)[1][0]
    simulation.close()
    camera = ROBOT.camera.position[0]
    assert depth[23, 32] == pytest.approx(2.0 - camera - 0.3, abs=0.01)
    assert not math.isclose(depth[23, 2], depth[23, 32], abs_tol=0.5)


# ---- touches


def standing_in_the_way(make_setup, name, kind="posts"):
    """A robot that stands at (0, 0), and a mover that comes along the x axis from 2 m off, at 1 m/s."""
    along = {kind: 1, "size": [0.5, 0.4], "path": [[2, 0], [-2, 0]], "speed": 1.0}
    spec = among(make_setup(World.from_shapes("floor", start=(0, 0, 0), bounds=(-9, -9, 9, 9)), beams=9), along)
    simulation, start = simulate(name, spec), InitialState.default(spec, 1)
    return simulation, simulation.reset(start, np.random.default_rng(0))


@pytest.mark.parametrize("kind", ["posts", "boxes"])
@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_what_runs_into_a_standing_robot_touches_it_and_stops_without_pushing(name, kind, make_setup):
    simulation, robot_state = standing_in_the_way(make_setup, name, kind)
    readings = [simulation.step(np.zeros((1, 2)), STEP) for _ in range(30)]
    touched = [bool(robot_state.bumped[0]) for robot_state in readings]
    first = touched.index(True)
    assert 2 < first < 25
    assert all(touched[first:])
    assert all(robot_state.nearest_is_dynamic[0] for robot_state in readings[first:])
    assert np.hypot(*readings[-1].pose[0, :2]) < 2e-3
    assert gap(readings[-1].dynamic_obstacles[0], readings[-1].pose[0]) - ROBOT.radius == pytest.approx(0.002, abs=1e-3)
    assert robot_state.dynamic_obstacles.shape == (1, 1, 6)
    assert np.hypot(*robot_state.dynamic_obstacles[0, 0, :2]) > 1.5, "earlier readings keep what they show"
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_what_waits_goes_on_when_the_robot_has_gone(name, make_setup):
    simulation, _ = standing_in_the_way(make_setup, name)
    while not (robot_state := simulation.step(np.zeros((1, 2)), STEP)).bumped[0]:
        pass
    side = np.sign(robot_state.dynamic_obstacles[0, 0, X])
    for _ in range(10):  # to the left and a little away from it
        simulation.step(np.array([[0.0, (math.pi / 2 + 0.5 * side) / 2]]), STEP)
    for _ in range(10):
        robot_state = simulation.step(np.array([[0.5, 0.0]]), STEP)
    assert abs(robot_state.pose[0, 1]) > 0.6
    for _ in range(5):
        robot_state = simulation.step(np.zeros((1, 2)), STEP)
    assert np.sign(robot_state.dynamic_obstacles[0, 0, X]) == -side
    assert not robot_state.bumped[0]
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_a_robot_that_drives_into_something_slower_stops_at_it(name, make_setup):
    path = {"posts": 1, "path": [[2, -1e-3], [2, 1e-3]], "speed": 1e-3}
    spec = among(make_setup(World.from_shapes("floor", start=(0, 0, 0), bounds=(-9, -9, 9, 9)), beams=9), path)
    simulation = simulate(name, spec)
    simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    for _ in range(25):
        robot_state = simulation.step(np.array([[0.5, 0.0]]), STEP)
    assert robot_state.bumped[0]
    assert robot_state.nearest_is_dynamic[0]
    assert robot_state.pose[0, 0] == pytest.approx(2 - 0.25 - ROBOT.radius, abs=5e-3)
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_a_wall_that_is_touched_is_nothing_that_moves(name, make_setup):
    wall = [(1.0, 0.0, 0.2, 4.0, 0.0)]
    far = {"posts": 1, "path": [[-6, -6], [-6, 6]]}
    world = World.from_shapes("wall", wall, start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    spec = among(make_setup(world, beams=9), far)
    simulation = simulate(name, spec)
    simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    for _ in range(15):
        robot_state = simulation.step(np.array([[0.5, 0.0]]), STEP)
    assert robot_state.bumped[0]
    assert not robot_state.nearest_is_dynamic[0]
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_a_wall_that_is_touched_counts_although_something_touches_the_robot_from_behind(name, make_setup):
    wall = World.from_shapes("wall", [(1.0, 0.0, 0.2, 4.0, 0.0)], start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    post = {"posts": 1, "path": [[-3, 0], [0.8, 0]], "speed": 0.6}  # it comes back once the robot is at the wall
    spec = among(make_setup(wall, beams=9), post)
    simulation = simulate(name, spec)
    simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    moving = []
    for _ in range(100):
        robot_state = simulation.step(np.array([[0.2, 0.0]]), STEP)
        behind = gap(robot_state.dynamic_obstacles[0], robot_state.pose[0])[0] < ROBOT.radius + 5e-3
        if behind and robot_state.bumped[0]:
            moving.append(bool(robot_state.nearest_is_dynamic[0]))
    assert len(moving) > 5
    assert not any(moving)
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_what_is_far_off_goes_at_its_speed_while_the_robot_is_at_a_wall(name, make_setup):
    wall = World.from_shapes("wall", [(0.3, 0.0, 0.2, 4.0, 0.0)], start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    far = {"boxes": 1, "path": [[-6, -100], [-6, 100]], "speed": 0.5}
    spec = among(make_setup(wall, beams=9), far)
    simulation = simulate(name, spec)
    before = simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0)).dynamic_obstacles
    for _ in range(5):
        robot_state = simulation.step(np.array([[0.5, 0.0]]), STEP)
    assert robot_state.bumped[0]
    assert np.abs(robot_state.dynamic_obstacles - before)[0, 0, Y] == pytest.approx(0.5 * 5 * STEP)
    simulation.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
@pytest.mark.parametrize("ahead", ["post", "wall"])
def test_what_is_nearest_along_the_beams_is_told_apart(name, ahead, make_setup):
    """A post in sight at 1.25 m, a wall behind the robot's back at 0.5 m, and one ahead at 1 m or at 3 m."""
    path = {"posts": 1, "path": [[1.5, -1e-3], [1.5, 1e-3]], "speed": 1e-3}
    walls = [(-0.6, 0.0, 0.2, 4.0, 0.0), (3.1 if ahead == "post" else 1.1, 0.0, 0.2, 4.0, 0.0)]
    world = World.from_shapes("walls", walls, start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    spec = among(make_setup(world, beams=5, field_of_view=1.0), path)
    simulation = simulate(name, spec)
    robot_state = simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    assert robot_state.nearest_is_dynamic.tolist() == [ahead == "post"]
    assert robot_state.nearest[0] == pytest.approx(1.25 if ahead == "post" else 1.0, abs=1e-3)
    simulation.close()


# ---- going on to the bit


def recorded(simulation, told):
    """All that readings of a drive say, to compare to the bit."""
    rows = [simulation.step(each, STEP).state() for each in told]
    return [{name: np.asarray(value).tobytes() for name, value in row.items()} for row in rows]


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
@pytest.mark.parametrize("dynamic_obstacles", [MIXED, {"people": 3, "avoid_robot": True}], ids=["mixed", "seeing"])
def test_states_and_copies_go_on_to_the_bit(name, dynamic_obstacles, make_setup):
    spec, rng = among(make_setup("loop", beams=9, noise=0.01), dynamic_obstacles), np.random.default_rng(1)
    simulation, told = simulate(name, spec), [*drives(rng, 30)]
    simulation.reset(begin(spec, rng), np.random.default_rng(0))
    recorded(simulation, told[:15])
    copies = [copy.deepcopy(simulation), pickle.loads(pickle.dumps(simulation))]
    expected = recorded(simulation, told)
    for each in copies:
        assert recorded(each, told) == expected
        each.close()
    state = simulation.state()
    expected = recorded(simulation, told)
    simulation.reset(begin(spec, rng), np.random.default_rng(0))
    recorded(simulation, told)
    other = simulate(name, spec)
    other.reset(begin(spec, rng), np.random.default_rng(0))
    for each in (simulation, other):
        each.restore(pickle.loads(pickle.dumps(state)))
        assert recorded(each, told) == expected
        each.close()


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
@pytest.mark.parametrize("seed", range(3))
def test_the_same_start_gives_the_same_episode_whatever_was_before(name, seed, make_setup):
    spec, rng = among(make_setup("loop", beams=9), [*MIXED, {"posts": 4}]), np.random.default_rng(seed)
    start, told = begin(spec, rng), [*drives(rng, 40)]
    episodes = []
    for before in range(3):
        simulation = simulate(name, spec)
        for _ in range(before):
            simulation.reset(begin(spec, rng), np.random.default_rng(0))
            recorded(simulation, drives(rng, 10))
        simulation.reset(InitialState(start.table.copy()), np.random.default_rng(0))
        episodes.append(recorded(simulation, told))
        simulation.close()
    assert episodes[0] == episodes[1] == episodes[2]


@pytest.mark.parametrize("name", ["bullet", "kinematic"])
def test_a_state_of_people_on_an_open_floor_goes_on(name, make_setup):
    spec = among(make_setup(beams=9), {"people": 2})
    simulation = simulate(name, spec)
    simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    recorded(simulation, [*drives(np.random.default_rng(0), 5)])
    state = simulation.state()
    told = [*drives(np.random.default_rng(1), 10)]
    expected = recorded(simulation, told)
    simulation.restore(state)
    assert recorded(simulation, told) == expected
    simulation.close()


def test_robots_that_begin_anew_leave_the_others_and_their_movers_alone(make_setup):
    spec, rng = among(make_setup("loop", "maze", beams=9, noise=0.01), MIXED), np.random.default_rng(1)
    start, anew = begin(spec, rng, 20), np.array([0, 3, 11])
    runs, told = [], rng.uniform((-0.1, -1), (0.6, 1), (20, 20, 2))
    for restarting in (False, True):
        twin = KinematicSimulator(spec, 20)
        twin.reset(InitialState(start.table.copy()), np.random.default_rng(0))
        for each in told[:10]:
            robot_state = twin.step(each, STEP)
        if restarting:
            fresh = begin(spec, np.random.default_rng(5), 3)
            robot_state, first = twin.restart(anew, fresh, robot_state)
            np.testing.assert_array_equal(first.dynamic_obstacles, robot_state.dynamic_obstacles[anew])
            np.testing.assert_array_equal(first.nearest_is_dynamic, robot_state.nearest_is_dynamic[anew])
            np.testing.assert_array_equal(first.ranges, robot_state.ranges[anew])
            beginner = KinematicSimulator(spec, 3).reset(fresh, np.random.default_rng(0))
            np.testing.assert_array_equal(first.dynamic_obstacles, beginner.dynamic_obstacles)
        runs.append([twin.step(each, STEP) for each in told[10:]])
    others = np.setdiff1d(np.arange(20), anew)
    for without, with_restart in zip(*runs, strict=True):
        for name in ("pose", "ranges", "dynamic_obstacles", "nearest_is_dynamic"):
            np.testing.assert_array_equal(getattr(without, name)[others], getattr(with_restart, name)[others])


def test_threads_and_the_number_of_robots_change_nothing(make_setup, monkeypatch):
    spec, rng = among(make_setup("loop", beams=9), MIXED), np.random.default_rng(1)
    start, told = begin(spec, rng, 64), rng.uniform((-0.1, -1), (0.6, 1), (10, 64, 2))
    ends = []
    for worth, robots in ((0.0, 64), (1e9, 64), (1e9, 7)):
        monkeypatch.setattr("tb2rl.simulation.kinematic.simulator.WORTH_THREADS", worth)
        monkeypatch.setattr("tb2rl.simulation.kinematic.WAKING", 0.0)
        twin = KinematicSimulator(spec, robots)
        twin.reset(InitialState(start.table[:robots].copy()), np.random.default_rng(0))
        for each in told:
            robot_state = twin.step(each[:robots], STEP)
        ends.append((robot_state.pose[:7], robot_state.dynamic_obstacles[:7], robot_state.ranges[:7]))
    for each in ends[1:]:
        for one, other in zip(ends[0], each, strict=True):
            np.testing.assert_array_equal(one, other)


def worse(state, change):
    state = copy.deepcopy(state)
    change(state["dynamic_obstacles"]["table"])
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
    spec = among(make_setup("loop", beams=9), MIXED)
    simulation = simulate(name, spec)
    simulation.reset(begin(spec, np.random.default_rng(0)), np.random.default_rng(0))
    state = simulation.state()
    with pytest.raises(ValueError, match="mover"):
        simulation.restore(worse(state, change))
    with pytest.raises(ValueError, match="mover"):
        simulation.restore(
            {
                **state,
                "dynamic_obstacles": {
                    **state["dynamic_obstacles"],
                    "table": state["dynamic_obstacles"]["table"][:, :2],
                },
            }
        )
    simulation.restore(state)
    simulation.close()


def test_a_robot_out_of_reach_of_all_movers_drives_to_the_bit_as_one_alone(make_setup):
    world = World.from_shapes("floor", start=(0, 0, 0), bounds=(-9, -9, 9, 9))
    far, told = (
        {"boxes": 2, "path": [[-8, -8], [-8, 8]]},
        np.random.default_rng(0).uniform((-0.3, -2), (0.6, 2), (40, 2)),
    )
    poses = []
    for spec in (make_setup(world, beams=9), among(make_setup(world, beams=9), far)):
        twin = KinematicSimulator(spec)
        twin.reset(InitialState.default(spec, 1), np.random.default_rng(0))
        poses.append([twin.step(each[None], STEP).pose for each in told])
    np.testing.assert_array_equal(*poses)
