"""The safety filter protects from any policy, and costs a good one nothing; it decides alike with and without numba."""

import math
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tb2rl import evaluate
from tb2rl.core.errors import InputError
from tb2rl.envs import safe_motion, safety
from tb2rl.envs.control_loop import SeededLoop
from tb2rl.envs.filters import SensedState
from tb2rl.envs.parts import robot_facts
from tb2rl.envs.safety import REASONS, Safety
from tb2rl.envs.scene import make_scene
from tb2rl.simulation.variation import find_variation
from tb2rl.tasks.drive import Drive

RNG = np.random.default_rng(0)
GUARANTEED = {"safety": {"setting": "guaranteed"}}
MIXED = {"generator": "mixed", "worlds": 50}
ONLY_TOUCHES = {"world": MIXED, "collision_range": 0.0, "start_clearance": 0.25, "beams": 60}
_COMPILED = [(module, name) for module in (safe_motion, safety) for name in vars(module)]
_COMPILED = [(module, name) for module, name in _COMPILED if hasattr(getattr(module, name), "py_func")]


def drive_full_speed_at_the_nearest(scene, robot_state):
    """Actions that turn to the nearest obstacle at full speed."""
    nearest = scene.laser.angles[robot_state.ranges.argmin(axis=1)]
    return np.stack([np.ones(len(nearest)), np.clip(2.0 * nearest, -1.0, 1.0)], axis=1).astype(np.float32)


def drive_randomly(scene, robot_state):
    """Random actions."""
    return RNG.uniform(-1.0, 1.0, (len(robot_state.pose), 2)).astype(np.float32)


def count_touches(act, num_envs, steps, simulation="kinematic", **settings):
    """Number of touches, and the distance per step [m], of a policy in a number of environments."""
    scene = make_scene(Drive(**{**ONLY_TOUCHES, **settings}), "raw").for_purpose("test")
    touches = distance = 0.0
    with closing(SeededLoop.open(scene, simulation, num_envs)) as loop:
        loop.seed(1)
        observations = loop.reset_all()
        for _ in range(steps):
            before = loop.distances.copy()
            transition = loop.step(act(scene, loop.robot_state))
            touches += loop.robot_state.bumped.sum()
            distance += (loop.distances - before).sum()
            if transition.finished is not None:
                loop.reset_some(transition.finished.indices, transition.observations)
        del observations
    return touches, distance / num_envs / steps


@pytest.mark.parametrize("act", [drive_randomly, drive_full_speed_at_the_nearest])
@pytest.mark.parametrize("variation", ["none", "strong"])
def test_nobody_touches_anything_with_the_guaranteed_filter(act, variation):
    assert count_touches(act, 64, 150, variation=variation, filters=(GUARANTEED,))[0] == 0
    assert count_touches(act, 64, 150, variation=variation)[0] > 50


@pytest.mark.bullet
@pytest.mark.slow
@pytest.mark.parametrize("variation", ["none", "strong"])
def test_nobody_touches_anything_in_physics(variation):
    for act in (drive_randomly, drive_full_speed_at_the_nearest):
        settings = {"variation": variation, "filters": (GUARANTEED,), "simulation": "bullet"}
        assert count_touches(act, 20, 300, **settings)[0] == 0


def test_random_still_covers_half_the_distance_of_a_step():
    _, with_filter = count_touches(drive_randomly, 256, 300, filters=(GUARANTEED,))
    touches, without = count_touches(drive_randomly, 256, 60)
    assert touches > 100
    assert with_filter >= 0.5 * without


@pytest.mark.parametrize("setting", ["usual", "guaranteed"])
def test_a_good_policy_is_left_alone(setting):
    settings = {"filters": [{"safety": {"setting": setting}}], "variation": "none"}
    evaluation = evaluate("zoo:anywhere-ppo", settings=settings, episodes=20, steps=150, simulation="kinematic")
    assert evaluation.summary()["failure_free_rate"] == 1.0
    assert evaluation.summary()["mean_filtered"] < 3.0


def make_filter(setting="usual", scans=1, **changes):
    """A safety filter for one robot with a laser all around, and a function that filters one command."""
    task = replace(Drive(variation="none", beams=121), **changes)
    scene = make_scene(task, "raw")
    safety_filter = Safety(robot_facts(task, scene.spec), setting, scans=scans)
    safety_filter.reset(1)

    def ask(command, ranges, twist=(0.0, 0.0), age=0.0, pose=(0.0, 0.0, 0.0)):
        arrays = [np.array([each], dtype=float) for each in (ranges, pose, twist)]
        sensed_state = SensedState(*arrays, np.array([False]), np.array([twist]), np.array([age]))
        (filtered,) = safety_filter(np.array([command], dtype=float), sensed_state)
        return filtered.tolist(), safety_filter.reason(0)

    return ask, scene.laser.angles


def wall_ahead(angles, distance):
    """Ranges of a wall across the way."""
    return np.where(np.abs(angles) < 1.5, distance / np.cos(np.clip(angles, -1.5, 1.5)), np.inf)


def test_it_slows_down_before_a_wall_and_stops_at_it_but_never_speeds_up():
    ask, angles = make_filter("guaranteed")
    speeds = [ask((0.6, 0.0), wall_ahead(angles, distance))[0][0] for distance in (3.0, 0.45, 0.35, 0.25, 0.19)]
    assert speeds[0] == 0.6
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == 0.0
    assert ask((0.1, 0.3), wall_ahead(angles, 3.0)) == ([0.1, 0.3], "")


def test_a_robot_at_a_wall_may_turn_and_drive_away_and_hears_why_it_may_not_go_on():
    ask, angles = make_filter()
    assert ask((0.0, 1.0), wall_ahead(angles, 0.19)) == ([0.0, 1.0], "")
    command, reason = ask((0.5, 0.0), wall_ahead(angles, 0.19))
    assert (command[0], reason) == (0.0, REASONS[1])
    beside = np.where(np.abs(angles) > 1.56, 0.19, np.inf)
    assert ask((0.5, 0.0), beside)[0] == [0.5, 0.0]


def test_it_forbids_what_the_laser_does_not_see():
    ask, angles = make_filter()
    assert ask((-0.2, 0.5), np.full(len(angles), np.inf)) == ([0.0, 0.5], REASONS[2])
    narrow, angles = make_filter(field_of_view=math.radians(58), beams=30, control_period=0.6)
    free = np.full(len(angles), np.inf)
    assert narrow((0.5, 0.0), free)[0] == [0.5, 0.0]
    (v, _), reason = narrow((0.2, 2.0), free)
    assert v < 0.2
    assert reason


def test_late_scans_and_late_commands_cost_speed():
    ask, angles = make_filter("guaranteed")
    prompt = ask((0.6, 0.0), wall_ahead(angles, 0.5), twist=(0.4, 0.0))[0][0]
    ask((0.4, 0.0), wall_ahead(angles, 3.0))
    late = ask((0.6, 0.0), wall_ahead(angles, 0.5), twist=(0.4, 0.0), age=0.2)[0][0]
    assert late < prompt
    slow, _ = make_filter("guaranteed", variation={"latency": [0, 1]})
    slow((0.4, 0.0), wall_ahead(angles, 3.0))
    assert slow((0.6, 0.0), wall_ahead(angles, 0.5), twist=(0.4, 0.0))[0][0] < prompt


def test_kept_scans_hold_a_robot_whose_latest_ranges_are_too_long():
    ask, angles = make_filter(scans=2)
    near, far = wall_ahead(angles, 0.2), wall_ahead(angles, 1.0)
    assert ask((0.5, 0.0), near)[0][0] < 0.01
    assert ask((0.5, 0.0), far)[0][0] < 0.01, "the scan before saw the wall"
    assert ask((0.5, 0.0), far)[0][0] == 0.5, "both scans see the wall far away"
    forgetful, _ = make_filter()
    forgetful((0.5, 0.0), near)
    assert forgetful((0.5, 0.0), far)[0][0] == 0.5


def test_the_points_of_kept_scans_stay_where_they_are_while_the_robot_drives_and_turns():
    free, command, start = np.full(121, np.inf), (0.5, 0.0), (3.0, -2.0, 0.7)

    def drives(ahead, turn):
        """Whether a robot may drive after a wall 0.6 m ahead, a way straight ahead [m], and a turn on the spot."""
        ask, angles = make_filter(scans=2)
        ask((0.0, 0.0), wall_ahead(angles, 0.6), pose=start)
        pose = (start[0] + ahead * math.cos(start[2]), start[1] + ahead * math.sin(start[2]), start[2] + turn)
        return ask(command, free, pose=pose)[0] == list(command)

    assert drives(0.0, 0.0)
    assert not drives(0.39, 0.0)
    assert not drives(0.39, 0.3)
    assert drives(0.39, math.pi)


def test_a_new_episode_begins_without_kept_scans():
    task = Drive(variation="none", beams=121)
    scene = make_scene(task, "raw")
    safety_filter, command = Safety(robot_facts(task, scene.spec), scans=2), np.array([(0.5, 0.0)])
    near = wall_ahead(scene.laser.angles, 0.2)[None]
    state = SensedState(near, np.zeros((1, 3)), np.zeros((1, 2)), np.array([False]), np.zeros((1, 2)), np.zeros(1))
    safety_filter.reset(1)
    safety_filter(command, state)
    saved, free = safety_filter.state(), state._replace(ranges=np.full_like(near, np.inf))
    assert safety_filter(command, free)[0, 0] < 0.01
    safety_filter.restore(saved)
    assert safety_filter(command, free)[0, 0] < 0.01, "as after the scan of the wall"
    safety_filter.restore(saved)
    safety_filter.reset_at(np.array([0]))
    assert safety_filter(command, free)[0, 0] == 0.5


def test_the_bounds_of_guaranteed_are_those_of_the_variation():
    scene = make_scene(Drive(variation="strong"), "raw")
    facts, strong = robot_facts(scene.task, scene.spec), find_variation("strong")
    bounds, robot = facts["guaranteed"], scene.robot
    assert bounds["latency"] == 1 * scene.task.control_period
    assert bounds["accelerations"][0] < robot.wheel_acceleration * strong.acceleration[0] / strong.mass[1]
    assert bounds["accelerations"][1] > robot.wheel_acceleration * strong.acceleration[1] / strong.mass[0]
    assert bounds["error"] > strong.bias[1] + strong.laser_noise[1]
    assert facts["usual"]["error"] == 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"beams": 30}, "at least every 5.5 degrees"),
        ({"field_of_view": 2.0, "filters": (GUARANTEED,)}, "sees 180 degrees, not 115"),
        ({"filters": ({"safety": {"setting": "certain"}},)}, "usual or guaranteed, got 'certain'"),
        ({"filters": ({"safety": {"margin": -1.0}},)}, "margin at least 0 m"),
        ({"filters": ({"safety": {"scans": 0}},)}, "scans must be from 1 to 10, got 0"),
    ],
)
def test_a_laser_or_a_setting_that_does_not_fit_is_named(settings, message):
    with pytest.raises(InputError, match=message):
        make_scene(Drive(**{"filters": ("safety",), **settings}), "raw")


@pytest.fixture
def without_numba(monkeypatch):
    """A function that runs the filter as a robot without numba does."""

    def run():
        for module, name in _COMPILED:
            monkeypatch.setattr(module, name, getattr(module, name).py_func)

    return run


@pytest.mark.parametrize(
    ("setting", "variation", "count"),
    [
        ("usual", "strong", 500),
        ("guaranteed", "strong", 500),
        pytest.param("usual", "none", 50_000, marks=pytest.mark.slow),
        pytest.param("guaranteed", "strong", 50_000, marks=pytest.mark.slow),
    ],
)
def test_compiled_and_plain_code_decide_alike(setting, variation, count, without_numba):
    scene = make_scene(Drive(variation=variation, beams=60), "raw")
    rng, model = np.random.default_rng(7), Safety(robot_facts(scene.task, scene.spec), setting)._model
    distances = rng.uniform(0.15, 1.5, (count, 1, 1)) * rng.uniform(0.7, 1.5, (count, 2, 60))
    scans, poses = (
        np.where(rng.random(distances.shape) < 0.05, np.inf, distances),
        rng.uniform(-0.1, 0.1, (count, 2, 3)),
    )
    velocities = rng.uniform((0.0, -2.0), (0.65, 2.0), (2, count, 2))
    ages, issued = rng.choice([0.0, 0.2], count), rng.uniform((0.0, -2.0), (0.65, 2.0), (count, 5, 2))
    compiled = safe_motion.filter_commands(model, velocities[0], scans, poses, velocities[1], ages, issued)
    without_numba()
    plain = safe_motion.filter_commands(model, velocities[0], scans, poses, velocities[1], ages, issued)
    np.testing.assert_allclose(compiled[0], plain[0], atol=1e-9)
    np.testing.assert_array_equal(compiled[1], plain[1])
    assert 0.05 < (compiled[1] > 0).mean() < 0.95
