"""Robots among dynamic obstacles: both simulators have the same ones, and touch and measure them alike."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.obstacles.outlines import FIELDS, LENGTH, X
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import parse_dynamic_obstacles

PERIOD = 0.2  # [s]
PATHS = [{"posts": 5, "path": [[-4, -4], [-4, 4], [4, 4]]}, {"boxes": 3, "path": [[4, 4], [4, -4]], "closed": True}]
MIXED = [{"people": 2, "boxes": 1}, {"posts": 1, "path": [[-4, -4], [-4, 4]]}, {"people": 1, "avoid_robot": True}]
WALL = [(1.0, 0.0, 0.2, 4.0, 0.0)]


def among(spec, dynamic_obstacles):
    return replace(spec, dynamic_obstacles=parse_dynamic_obstacles(dynamic_obstacles, "dynamic_obstacles"))


def standing(x, radius=0.25):
    """A post that stands at (x, 0)."""
    return {"posts": 1, "radius": radius, "path": [[x, -1e-3], [x, 1e-3]], "speed": 1e-3}


@pytest.fixture
def on_floor(make_spec):
    """A function from dynamic obstacles to a spec of a floor with walls; the laser measures all around."""

    def make(dynamic_obstacles, walls=(), beams=720):
        world = World.from_shapes("floor", walls, start=(0, 0, 0), bounds=(-9, -9, 9, 9))
        return among(make_spec(world, beams=beams, field_of_view=math.tau, min_range=0.05), dynamic_obstacles)

    return make


@pytest.fixture
def start_on_floor(on_floor, simulator, open_simulator, begin):
    """A function from the same to each simulator, and its first state."""

    def make(*arguments):
        simulation = open_simulator(simulator, on_floor(*arguments))
        return simulation, begin(simulation)

    return make


def random_starts(spec, rng, num_envs=1):
    """Initial states anywhere, each with its own dynamic obstacles."""
    worlds = rng.integers(len(spec.worlds), size=num_envs)
    initial_state = InitialState.default(spec, num_envs, worlds)
    initial_state.pose[:] = spec.sample_poses(worlds, rng.random((num_envs, 4)), 0.3)
    initial_state.records["obstacle_seed"] = rng.random(num_envs)
    return initial_state


def random_commands(rng, steps=25):
    """Commands that change each second, mostly ahead, shape (steps, 1, 2)."""
    commands = np.column_stack([rng.uniform(-0.1, 0.6, steps // 5), rng.uniform(-1.5, 1.5, steps // 5)])
    return np.repeat(commands, 5, axis=0)[:, None]


def drive(simulation, commands):
    return [simulation.step(command, PERIOD).state() for command in commands]


# ---- both simulators


@pytest.mark.parametrize("dynamic_obstacles", [[{"people": 4}, *PATHS], {"people": 4, "avoid_robot": True}], ids=str)
def test_physics_and_kinematics_agree_until_the_first_touch(dynamic_obstacles, make_spec, make_physics, begin):
    spec = among(make_spec("loop", "maze", beams=36), dynamic_obstacles)
    physics, kinematic, rng = make_physics(spec), KinematicSimulator(spec), np.random.default_rng(0)
    apart, touches = [], []
    for _ in range(12):
        initial_state = random_starts(spec, rng)
        for simulation in (physics, kinematic):
            begin(simulation, InitialState(initial_state.table.copy()))
        for command in random_commands(rng):
            real, other = physics.step(command, PERIOD), kinematic.step(command, PERIOD)
            if real.bumped[0] or other.bumped[0]:
                touches.append((bool(real.nearest_is_dynamic[0]), bool(other.nearest_is_dynamic[0])))
                break
            tolerance = 0.05 if "avoid_robot" in str(dynamic_obstacles) else 1e-9
            assert np.abs(real.dynamic_obstacles - other.dynamic_obstacles).max() < tolerance
            east, north, turn = (real.pose - other.pose)[0]
            apart.append((math.hypot(east, north), abs(math.remainder(turn, math.tau))))
    distance, turn = np.median(apart, axis=0)
    assert distance < 0.03
    assert math.degrees(turn) < 3
    assert len(apart) > 150
    assert sum(real == other for real, other in touches) >= 0.9 * len(touches)
    assert any(real for real, _ in touches) or "avoid_robot" in str(dynamic_obstacles)


def test_the_rays_of_pybullet_hit_dynamic_obstacles_where_the_laser_does(make_spec, make_bullet, begin, ray_ranges):
    spec, rng, errors = (
        among(make_spec("loop", "maze", beams=36), [{"people": 4}, *PATHS]),
        np.random.default_rng(0),
        [],
    )
    bullet = make_bullet(spec)
    for _ in range(6):
        begin(bullet, random_starts(spec, rng))
        for command in random_commands(rng):
            robot_state = bullet.step(command, PERIOD)
            rays = ray_ranges(bullet, robot_state.pose[0], spec.laser.angles)
            seen = np.isfinite(robot_state.ranges[0])
            errors.extend(np.abs(rays - robot_state.ranges[0])[seen])
    assert np.mean(np.array(errors) > 5e-3) < 1e-3, "but for beams that graze an edge"


def test_without_dynamic_obstacles_a_state_has_none(simulator, make_spec, open_simulator, begin):
    robot_state = begin(open_simulator(simulator, make_spec("loop", beams=9)))
    assert robot_state.dynamic_obstacles is None
    assert robot_state.nearest_is_dynamic is None
    assert "dynamic_obstacles" not in robot_state.state()


def test_a_group_is_present_as_a_whole_in_its_share_of_the_episodes(make_spec, make_physics, begin):
    groups = [{"people": 3, "presence": 0.25}, {"posts": 1}, {"boxes": 2, "presence": 0.8}]
    spec = among(make_spec("loop", "maze", beams=9), groups)
    simulation, initial_state = KinematicSimulator(spec, 2000), random_starts(spec, np.random.default_rng(3), 2000)
    present = begin(simulation, initial_state).dynamic_obstacles[..., LENGTH] > 0
    assert ((present[:, :3] == present[:, [0]]).all(axis=1) & present[:, 3] & (present[:, 4] == present[:, 5])).all()
    shares = present[:, 0].mean(), present[:, 4].mean(), (present[:, 0] & present[:, 4]).mean()
    assert shares == pytest.approx([0.25, 0.8, 0.2], abs=0.03)
    again = KinematicSimulator(spec, 2000)
    again.restore(simulation.state())
    np.testing.assert_equal(*(drive(each, np.full((1, 2000, 2), 0.2)) for each in (simulation, again)))
    for i in (0, int(present[:, 0].argmax())):
        alone = begin(make_physics(spec), InitialState(initial_state.table[[i]].copy()))
        assert (alone.dynamic_obstacles[0, :, LENGTH] > 0).tolist() == present[i].tolist()


def test_depth_images_show_dynamic_obstacles(start_on_floor):
    """The row of pixels at the camera's height sees the front of a post."""
    depth = start_on_floor(standing(2, radius=0.3))[1].render_camera(64, 48)[1][0]
    assert depth[23, 32] == pytest.approx(2.0 - ROBOT.camera.position[0] - 0.3, abs=0.01)
    assert not math.isclose(depth[23, 2], depth[23, 32], abs_tol=0.5)


# ---- touches

ALONG_X = {"size": [0.5, 0.4], "path": [[2, 0], [-2, 0]], "speed": 1.0}


@pytest.mark.parametrize("kind", ["posts", "boxes"])
def test_a_dynamic_obstacle_stops_at_a_standing_robot_without_pushing_it(kind, start_on_floor):
    simulation, first = start_on_floor({kind: 1, **ALONG_X})
    states = [simulation.step(np.zeros((1, 2)), PERIOD) for _ in range(30)]
    touched = [bool(state.bumped[0]) for state in states]
    begins = touched.index(True)
    assert 2 < begins < 25
    assert all(touched[begins:])
    assert all(state.nearest_is_dynamic[0] for state in states[begins:])
    assert np.hypot(*states[-1].pose[0, :2]) < 2e-3
    assert states[-1].nearest_range[0] - ROBOT.radius == pytest.approx(0.002, abs=1e-3)
    assert first.dynamic_obstacles.shape == (1, 1, 6)
    assert np.hypot(*first.dynamic_obstacles[0, 0, :2]) > 1.5, "earlier states keep their values"


def test_a_waiting_obstacle_goes_on_when_the_robot_has_left(start_on_floor):
    simulation, _ = start_on_floor({"posts": 1, **ALONG_X})
    while not (robot_state := simulation.step(np.zeros((1, 2)), PERIOD)).bumped[0]:
        pass
    side = np.sign(robot_state.dynamic_obstacles[0, 0, X])
    turn = (0.0, (math.pi / 2 + 0.5 * side) / 2)  # to the left and a little away from it
    for command in [turn] * 10 + [(0.5, 0.0)] * 10 + [(0.0, 0.0)] * 5:
        robot_state = simulation.step(np.array([command]), PERIOD)
    assert abs(robot_state.pose[0, 1]) > 0.6
    assert np.sign(robot_state.dynamic_obstacles[0, 0, X]) == -side
    assert not robot_state.bumped[0]


def test_a_robot_stops_at_a_slower_obstacle(start_on_floor):
    simulation, _ = start_on_floor(standing(2))
    for _ in range(25):
        robot_state = simulation.step(np.array([[0.5, 0.0]]), PERIOD)
    assert robot_state.bumped[0]
    assert robot_state.nearest_is_dynamic[0]
    assert robot_state.pose[0, 0] == pytest.approx(2 - 0.25 - ROBOT.radius, abs=5e-3)


def test_a_wall_contact_counts_although_a_dynamic_obstacle_touches_the_robot_too(start_on_floor):
    path = [[-3, 0], [0.8, 0]]  # it comes back once the robot is at the wall
    simulation, _ = start_on_floor({"posts": 1, "path": path, "speed": 0.6}, WALL)
    moving = []
    for _ in range(100):
        robot_state = simulation.step(np.array([[0.2, 0.0]]), PERIOD)
        gap = robot_state.pose[0, 0] - robot_state.dynamic_obstacles[0, 0, X] - 0.25 - ROBOT.radius
        if gap < 5e-3 and robot_state.bumped[0]:
            moving.append(bool(robot_state.nearest_is_dynamic[0]))
    assert len(moving) > 5
    assert not any(moving)


@pytest.mark.parametrize(("distance", "nearest", "is_dynamic"), [(3.1, 1.25, True), (1.1, 1.0, False)])
def test_the_nearest_along_the_beams_is_a_post_or_a_wall(
    distance, nearest, is_dynamic, on_floor, simulator, open_simulator, begin
):
    walls = [(-0.6, 0.0, 0.2, 4.0, 0.0), (distance, 0.0, 0.2, 4.0, 0.0)]  # one behind, where no beam points
    spec = on_floor(standing(1.5), walls, 5)
    robot_state = begin(open_simulator(simulator, replace(spec, laser=replace(spec.laser, field_of_view=1.0))))
    assert robot_state.nearest_is_dynamic.tolist() == [is_dynamic]
    assert robot_state.nearest_range[0] == pytest.approx(nearest, abs=1e-3)


# ---- exact repetition


def test_the_same_initial_state_gives_the_same_episode_whatever_was_before(simulator, make_spec, open_simulator, begin):
    spec, rng = among(make_spec("loop", beams=9), [*MIXED, {"posts": 4}]), np.random.default_rng(0)
    initial_state, commands, episodes = random_starts(spec, rng), random_commands(rng, 40), []
    for before in range(3):
        simulation = open_simulator(simulator, spec)
        for _ in range(before):
            begin(simulation, random_starts(spec, rng))
            drive(simulation, random_commands(rng, 10))
        begin(simulation, InitialState(initial_state.table.copy()))
        episodes.append(drive(simulation, commands))
    np.testing.assert_equal(episodes[1:], episodes[:1] * 2)


@pytest.mark.parametrize(("row", "field", "value"), [(0, "x", np.nan), (0, "length", 3.0), (3, "next", 1e9)])
def test_a_state_of_other_obstacles_is_refused(row, field, value, make_spec, begin):
    simulation = KinematicSimulator(among(make_spec("loop", beams=9), MIXED))
    begin(simulation)
    state = simulation.state()
    state["dynamic_obstacles"]["table"][0, row, FIELDS.index(field)] = value
    with pytest.raises(ValueError, match="dynamic obstacle"):
        simulation.restore(state)
