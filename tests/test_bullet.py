"""The physics: the robot reaches its speeds, stands still, stays inside the walls, and its sensors tell the truth."""

import math
import subprocess
import sys
from contextlib import closing

import numpy as np
import pytest
import shapely

from tb2rl.maze import load_maze, maze_from, maze_names
from tb2rl.robot import BASE_RADIUS, LASER_NOISE, MAX_SPEED, MAX_TURN_RATE, Laser
from tb2rl.simulation.bullet import BulletSimulation

OPEN = {"boxes": [{"centre": [19, 19], "size": [1, 1]}], "bounds": [-20, -20, 20, 20]}
TARGETS = {
    "a wall": {"boxes": [{"centre": [0, 0], "size": [0.2, 6]}]},
    "a wall turned by 30 degrees": {"boxes": [{"centre": [0, 0], "size": [0.2, 6], "yaw": math.radians(30)}]},
    "a corner": {"boxes": [{"centre": [0, 0], "size": [1, 1], "yaw": math.radians(45)}]},
    "a post": {"posts": [{"centre": [0, 0], "radius": 0.3}]},
    "a thin post": {"posts": [{"centre": [0, 0], "radius": 0.03}]},
}
ONE_BEAM = Laser(beams=1)
WANDER = [(0.5, 0.0), (0.05, 1.0), (0.05, -1.0)]  # v [m/s], w [rad/s]


def simulate(content=OPEN, laser=ONE_BEAM):
    maze = maze_from({"start": [-2, 0, 0], "bounds": [-5, -5, 5, 5], **content}, "test")
    return closing(BulletSimulation(maze, laser))


def place(simulation, x=0.0, y=0.0, yaw=0.0, seed=0):
    return simulation.reset(np.array([[x, y, yaw]]), np.random.default_rng(seed))


def drive(simulation, commands, duration=0.2):
    """The readings of one robot that is told each of `commands` (steps, 2) for `duration` [s]."""
    return [simulation.step(np.array([command]), duration) for command in commands]


def gap(pose, other):
    """Distance [m] and angle [rad] between two poses (1, 3)."""
    dx, dy, turn = (pose - other)[0]
    return math.hypot(dx, dy), abs(math.remainder(turn, math.tau))


def gaps(simulation, readings):
    """Distances between the base and the nearest wall [m], all around, shape (readings,)."""
    return np.array([simulation.maze.clearance(*reading.pose[0, :2]) for reading in readings]) - BASE_RADIUS


def tilt(simulation):
    qx, qy, _, _ = simulation.state().orientation
    return math.acos(1 - 2 * (qx * qx + qy * qy))


def record(readings):
    """Everything in some readings as one array, to compare to the bit."""
    return np.array([np.hstack([r.pose, r.twist, r.odometry, r.ranges, r.bumped[:, None]])[0] for r in readings])


# ---- driving


@pytest.mark.parametrize("v", [-MAX_SPEED, -0.3, -0.05, 0.0, 0.05, 0.5, MAX_SPEED])
def test_a_commanded_speed_is_reached_within_2_percent(v):
    with simulate() as simulation:
        for w in (-MAX_TURN_RATE, -1.0, -0.3, 0.0, 0.3, 1.0, MAX_TURN_RATE):
            place(simulation)
            before, after = drive(simulation, [(v, w)] * 2, 1.5)
            assert np.allclose(after.twist, (v, w), rtol=0.02, atol=2e-3)
            turned = math.remainder((after.pose - before.pose)[0, 2] - 1.5 * w, math.tau)
            assert abs(turned) <= 0.02 * 1.5 * abs(w) + 2e-3


@pytest.mark.parametrize("duration", [0.01, 0.05, 0.07, 0.2, 1.0])
def test_a_step_lasts_as_long_as_it_was_asked_to(duration):
    with simulate() as simulation:
        place(simulation)
        before, after = drive(simulation, [(0.5, 0.0)], 1.0)[0], drive(simulation, [(0.5, 0.0)], duration)[0]
        assert gap(after.pose, before.pose)[0] == pytest.approx(0.5 * duration, rel=0.01)


def test_commands_beyond_the_limits_are_cut():
    with simulate() as simulation:
        place(simulation)
        assert drive(simulation, [(5.0, 0.0)], 2.0)[-1].twist == pytest.approx(np.array([[MAX_SPEED, 0]]), abs=0.01)
        assert drive(simulation, [(0.0, -50.0)], 3.0)[-1].twist == pytest.approx(
            np.array([[0, -MAX_TURN_RATE]]), abs=0.01
        )


def test_it_starts_from_rest_and_gains_speed_as_a_robot_would():
    with simulate() as simulation:
        assert (place(simulation).twist == 0).all()
        speeds = np.array([reading.twist[0, 0] for reading in drive(simulation, [(0.5, 0.0)] * 50, 0.01)])
    assert speeds[1] < 0.25
    assert speeds[-1] >= 0.95 * 0.5
    assert np.diff(speeds, prepend=0).max() / 0.01 < 10  # [m/s^2]


def test_it_stands_still_when_told_to():
    with simulate() as simulation:
        start = place(simulation, 1.0, 2.0, 0.5)
        distance, turn = gap(drive(simulation, [(0.0, 0.0)] * 50)[-1].pose, start.pose)
    assert distance < 1e-3
    assert math.degrees(turn) < 0.1


# ---- walls


def heading_for_a_wall(maze, rng):
    """A random free pose that faces the nearest obstacle."""
    x, y, _ = maze.random_poses(rng, 1, 0.25)[0]
    _, nearest = shapely.shortest_line(shapely.Point(x, y), maze.obstacles).coords
    return x, y, math.atan2(nearest[1] - y, nearest[0] - x)


@pytest.mark.parametrize("name", maze_names())
def test_300_commands_into_walls_neither_tip_it_nor_get_it_through_nor_move_a_wall(name):
    maze, rng = load_maze(name), np.random.default_rng(0)
    limits = np.array([MAX_SPEED, MAX_TURN_RATE])
    probe, angles = maze.random_poses(rng, 1, 0.0)[0], np.linspace(-3, 3, 50)
    with closing(BulletSimulation(maze, ONE_BEAM)) as simulation:
        walls, bumps = simulation.ray_ranges(probe, angles), 0
        for _ in range(10):
            poses = [simulation.reset(np.array([heading_for_a_wall(maze, rng)]), rng).pose[0]]
            height = simulation.state().position[2]
            for step in range(30):
                command = limits * (rng.uniform(-1, 1, 2) if step % 2 else (rng.choice([1, 1, 1, -1]), 0))
                reading = simulation.step(command[None], 0.3)
                poses.append(reading.pose[0])
                bumps += reading.bumped[0]
                assert gaps(simulation, [reading]) >= -5e-3
                assert math.degrees(tilt(simulation)) < 3
                assert simulation.state().position[2] == pytest.approx(height, abs=5e-3)
            assert not maze.obstacles.intersects(shapely.LineString([pose[:2] for pose in poses]))
        assert bumps >= 5
        assert (simulation.ray_ranges(probe, angles) == walls).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("degrees", [0, 20, 45, -30])
def test_the_bumper_fires_when_the_laser_reads_contact_and_not_before(target, degrees):
    angle = math.radians(degrees)
    with simulate(TARGETS[target], Laser()) as simulation:
        for speed in (0.1, 0.5, MAX_SPEED):
            place(simulation, -math.cos(angle), -math.sin(angle), angle)
            readings = drive(simulation, [(speed, 0.0)] * int(1.5 / speed / 0.02), 0.02)
            bumped = np.array([reading.bumped[0] for reading in readings])
            assert bumped.any()
            assert abs(readings[bumped.argmax()].ranges.min() - BASE_RADIUS) < 0.01
            assert (gaps(simulation, readings)[bumped] < 0.01).all()


def test_a_wall_that_is_hit_at_full_speed_gives_way_by_less_than_5_mm():
    with simulate(TARGETS["a wall"]) as simulation:
        for x in np.linspace(-1.0, -1.012, 13):  # the last step before the wall ends anywhere within 1 cm of it
            place(simulation, x)
            assert gaps(simulation, drive(simulation, [(MAX_SPEED, 0.0)] * 110, 1 / 60)).min() > -5e-3


def test_the_bumper_feels_what_is_behind():
    with simulate(TARGETS["a wall"]) as simulation:
        place(simulation, -1.0, 0.0, math.pi)
        readings = drive(simulation, [(-0.5, 0.0)] * 100, 0.02)
        bumped = np.array([reading.bumped[0] for reading in readings])
        assert bumped.any()
        assert (gaps(simulation, readings)[bumped] < 0.01).all()


def test_the_bumper_remembers_a_touch_within_a_long_step():
    with simulate(TARGETS["a thin post"]) as simulation:
        place(simulation, -0.3, 0.03 + BASE_RADIUS - 0.01)
        (reading,) = drive(simulation, [(0.5, 0.0)], 1.5)
        assert reading.bumped[0]
        assert gaps(simulation, [reading]) > 0.1  # and has long passed


# ---- sensors


def odometry_error(commands, duration):
    """Error of the odometry [m, rad] after driving in the open."""
    with simulate() as simulation:
        place(simulation)
        last = drive(simulation, commands, duration)[-1]
        return gap(last.pose, last.odometry)


def test_odometry_starts_at_the_start_pose():
    with simulate() as simulation:
        place(simulation)
        drive(simulation, WANDER)
        assert place(simulation, 1.0, -2.0, 0.5).odometry.tolist() == [[1.0, -2.0, 0.5]]


def test_odometry_agrees_with_the_true_pose_after_20_s_of_smooth_driving():
    rng, command, commands = np.random.default_rng(0), np.zeros(2), []
    for _ in range(100):
        command = (command + rng.uniform((-0.1, -0.4), (0.1, 0.4))).clip((-0.6, -2.0), (0.6, 2.0))
        commands.append(command)
    assert odometry_error(commands, 0.2)[0] < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_odometry_agrees_with_the_true_pose_after_20_s_of_a_tasks_actions(seed):
    actions = np.random.default_rng(seed).integers(3, size=100)
    distance, turn = odometry_error([WANDER[action] for action in actions], 0.2)
    assert distance < 0.05
    assert math.degrees(turn) < 3


def test_odometry_does_not_depend_on_how_often_it_is_read():
    ends = []
    with simulate() as simulation:
        for times, duration in ((1, 4.0), (20, 0.2)):
            place(simulation)
            drive(simulation, [(0.02 * i, 0.1 * i) for i in range(11)], 0.1)  # gently: this is not about slip
            ends.append(drive(simulation, [(0.2, 1.0)] * times, duration)[-1].odometry)
    assert gap(*ends)[0] < 2e-3


def test_without_noise_the_laser_is_exact():
    with simulate(TARGETS["a wall"], Laser(beams=3)) as simulation:
        assert place(simulation, -1.5).ranges[0] == pytest.approx([math.inf, 1.4, math.inf])


def test_laser_noise_is_gaussian_independent_and_of_its_deviation():
    with simulate(TARGETS["a wall"], Laser(beams=720, noise=LASER_NOISE)) as simulation:
        readings = [place(simulation, -1.0, seed=1), *drive(simulation, [(0.0, 0.0)] * 49)]
    with simulate(TARGETS["a wall"], Laser(beams=720)) as simulation:
        exact = place(simulation, -1.0).ranges
    ranges = np.concatenate([reading.ranges for reading in readings])
    assert (np.isinf(ranges) == np.isinf(exact)).all()
    errors = ranges[:, np.isfinite(exact[0])] - exact[:, np.isfinite(exact[0])]
    assert errors.size > 20_000
    assert abs(errors.mean()) < 5 * LASER_NOISE / math.sqrt(errors.size)
    assert errors.std() == pytest.approx(LASER_NOISE, rel=0.03)
    assert (abs(errors) < LASER_NOISE).mean() == pytest.approx(0.683, abs=0.02)
    assert abs(np.corrcoef(errors[:-1].ravel(), errors[1:].ravel())[0, 1]) < 0.03
    assert abs(np.corrcoef(errors[:, :-1].ravel(), errors[:, 1:].ravel())[0, 1]) < 0.03


def test_readings_stay_within_what_the_laser_can_measure():
    laser = Laser(beams=3, noise=0.5, min_range=0.5, max_range=2.0)
    with simulate(TARGETS["a wall"], laser) as simulation:
        ranges = [place(simulation, -1.1, seed=seed).ranges[0, 1] for seed in range(300)]
        assert place(simulation, -4.5).ranges[0, 1] == math.inf
    assert min(ranges) == 0.5
    assert all(reading <= 2.0 or reading == math.inf for reading in ranges)


@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_the_camera_sees_a_wall_ahead_at_its_distance_and_in_its_colour(yaw):
    with simulate(TARGETS["a wall"]) as simulation:
        place(simulation, -2.0, 0.0, yaw)
        rgb, depth = simulation.camera(64, 48)
        assert (rgb.shape, rgb.dtype) == ((48, 64, 3), np.uint8)
        assert (depth.shape, depth.dtype) == ((48, 64), np.float32)
        assert depth[24, 32] == pytest.approx(1.9 / math.cos(yaw) - 0.05, abs=0.02)  # the lens: 5 cm ahead
        red, green, blue = rgb[24, 32].astype(int)
        assert red > green + 30 > blue + 30
        assert depth[0, 32] == math.inf  # over the wall


def test_looking_through_the_camera_changes_nothing():
    commands = [WANDER[i % 3] for i in range(10)]
    with simulate(TARGETS["a wall"], Laser(noise=LASER_NOISE)) as simulation:
        place(simulation, -1.5)
        expected = record(drive(simulation, commands))
        place(simulation, -1.5)
        readings = []
        for command in commands:
            simulation.camera(8, 6)
            readings += drive(simulation, [command])
    assert (record(readings) == expected).all()


# ---- the same again


def random_commands(seed, count=50):
    """Commands that turn either way and go forward more than back, so that they meet a wall."""
    return np.random.default_rng(seed).uniform((-0.3, -3.0), (MAX_SPEED, 3.0), (count, 2))


def test_a_reset_gives_the_same_trajectory_to_the_bit_whatever_happened_before():
    trajectories = []
    for past in (0, 1):
        with simulate(TARGETS["a wall"], Laser(beams=20, noise=LASER_NOISE)) as simulation:
            for seed in range(past, 3):  # the second simulation is younger by a drive
                place(simulation, -0.5, 0.5, seed=seed)
                drive(simulation, random_commands(seed))
            first = place(simulation, -0.5, seed=7)
            trajectories.append(record([first, *drive(simulation, random_commands(7))]))
    assert trajectories[0][:, -1].any()  # it met the wall
    assert (trajectories[0] == trajectories[1]).all()


def test_a_reset_to_where_it_stands_gives_the_same_trajectory_to_the_bit():
    with simulate(TARGETS["a wall"], Laser(beams=20)) as simulation:
        place(simulation, -0.5)
        expected = record(drive(simulation, random_commands(0)))
        for seed in (*range(20), 146, 152, 290, 299, 492, 601):  # the last ones: old contacts once lived on
            rng = np.random.default_rng(seed)
            place(simulation, *rng.normal((-0.5, 0.0, 0.0), (0.005, 0.005, 0.05)))
            drive(simulation, random_commands(seed, count=seed % 7), 0.02)
            place(simulation, -0.5)
            assert (record(drive(simulation, random_commands(0))) == expected).all()


@pytest.mark.parametrize("noise", [0.0, LASER_NOISE])
@pytest.mark.parametrize("steps", [0, 1, 5, 50])
def test_it_continues_from_a_restored_state_to_the_bit(steps, noise):
    with simulate(TARGETS["a wall"], Laser(beams=20, noise=noise)) as simulation:
        place(simulation, -0.5)
        drive(simulation, random_commands(0)[:steps])
        state = simulation.state()
        expected = record(drive(simulation, random_commands(1)))
        drive(simulation, random_commands(2))
        simulation.restore(state)
        assert (record(drive(simulation, random_commands(1))) == expected).all()


# ---- manners


def test_nothing_is_printed_and_nothing_of_the_user_is_lost():
    script = """
from tb2rl.envs import TurtleBot2Env
print("before", end=" ")
env = TurtleBot2Env()
env.reset(seed=0)
env.step(0)
env.camera()
env.close()
print("after")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("before after\n", "")
