"""Names become objects: what a scene holds, and what does not fit together."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import DEFAULT_BEAMS
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.robots.turtlebot3 import ROBOT as BURGER
from tb2rl.runs.config import resolve
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander


@pytest.mark.parametrize("mode", DEFAULT_BEAMS)
def test_the_number_of_beams_is_a_setting_and_so_are_the_ones_that_are_read(mode):
    for settings, beams in (
        ({"beams": 12}, 12),
        ({"beams": 12, "beam_indices": (0, 5, 11)}, 3),
        ({}, DEFAULT_BEAMS[mode]),
    ):
        scene = make_scene(Wander(**settings), mode)
        assert scene.observation_space.shape == scene.laser.angles.shape == (beams,)


@pytest.mark.parametrize(("mode", "step"), [("discrete", 30), ("raw", 180 / 35)])
def test_a_turtlebot3_that_sees_all_around_looks_ahead_like_a_turtlebot2_unless_its_field_of_view_is_set(mode, step):
    ahead, around = (make_task("maze", {"robot": "turtlebot3", **more}) for more in ({}, {"field_of_view": None}))
    angles = np.degrees(make_scene(ahead, mode).laser.angles)
    assert angles == pytest.approx(np.arange(-90, 90.1, step))
    all_around = make_scene(around, mode).laser.angles
    assert np.diff(all_around, append=all_around[0] + math.tau) == pytest.approx(math.tau / DEFAULT_BEAMS[mode])


def test_what_suits_a_robot_comes_along_with_its_name_before_what_is_set_beside_it():
    for settings, period in (({}, 0.4), ({"control_period": 0.3}, 0.3)):
        task = make_task("maze", {"robot": "turtlebot3", **settings})
        assert (task.control_period, task.field_of_view, task.collision_range) == (period, math.pi, 0.5)
    assert make_task("maze", {"robot": "turtlebot2"}) == make_task("maze", {}) == Wander()


def test_what_suited_a_robot_leaves_with_it_unless_it_was_set_otherwise():
    for settings, period in (({}, 0.2), ({"control_period": 0.3}, 0.3)):
        task = make_task(make_task("maze", {"robot": "turtlebot3", **settings}), {"robot": "turtlebot2"})
        assert (task.control_period, task.field_of_view) == (period, None)
    config = resolve("ppo", settings={"task.robot": "turtlebot3"}).with_task({"robot": "turtlebot2"})
    assert config.task == resolve("ppo").task


def test_a_robot_larger_than_a_task_counts_on_begins_farther_from_walls():
    task = make_task("navigate", {"robot": "jackal"})
    assert task.start_clearance == pytest.approx(0.31)
    assert make_task(task, {"robot": "turtlebot2"}) == make_task("navigate", {})
    assert make_task("navigate", {"robot": "jackal", "start_clearance": 0.4}).start_clearance == 0.4
    assert make_task("maze", {"robot": "jackal"}).start_clearance == Wander().start_clearance
    assert resolve("dwa", "navigate", settings={"task.robot": "jackal"}).task == task


def test_what_a_robot_brings_must_be_a_setting_of_every_task(monkeypatch):
    monkeypatch.setattr("tb2rl.robots.turtlebot3.ROBOT", replace(BURGER, task_settings={"control_perod": 0.4}))
    with pytest.raises(InputError, match=r"key of robot turtlebot3\.task_settings 'control_perod'; did you mean"):
        make_task("maze", {"robot": "turtlebot3"})


def test_a_scene_knows_the_goal_of_a_task_that_has_one():
    assert make_scene(Wander(world="wall"), "raw").goal_in(0) is None
    assert make_scene(ReachGoal(), "raw").goal_in(0) == (5.0, 0.0)
    assert make_scene(ReachGoal(world="loop", goal=(3.0, 1.0)), "raw").goal_in(0) == (3.0, 1.0)


def test_a_changed_scene_has_other_settings_and_the_same_objects():
    small = make_scene(Wander(robot="turtlebot3", turn_rate=9.0), "raw")
    assert (small.worlds_title, small.actions.table.tolist()[1]) == ("loop with turtlebot3", [0.05, 2.84])
    scene = make_scene(ReachGoal(), "discrete")
    settings = {"beams": 9, "laser_noise": 0.01, "episode_steps": 7, "goal": (1.0, 2.0), "turn_rate": 0.5}
    other = scene.in_worlds(scene.spec.worlds, **settings)
    assert (other.robot, other.world, other.observation) == (scene.robot, scene.world, "discrete")
    assert other.world is scene.world
    assert (other.task.episode_steps, other.goal_in(0), other.laser.noise) == (7, (1.0, 2.0), 0.01)
    assert other.observation_space.shape == (9 + 2,)
    assert other.actions.table[1, 1] == 0.5
    assert (scene.task, scene.goal_in(0), scene.observation_space.shape) == (ReachGoal(), (5.0, 0.0), (7 + 2,))


def test_a_world_too_narrow_for_the_robot_is_refused_however_it_starts(tmp_path):
    (tmp_path / "narrow.yaml").write_text("cell: 0.3\ndrawing: |\n  ###\n  #S#\n  ###\n")
    words = r"world narrow: the start .* nearer than 0\.178 m to a wall.* lower task\.start_clearance if that is 0\.178"
    for start in ("fixed", "random"):
        with pytest.raises(InputError, match=words):
            make_scene(Wander(world=str(tmp_path / "narrow.yaml"), start=start), "raw")


@pytest.mark.parametrize(
    ("mode", "task", "words"),
    [
        ("rew", Wander(), ["unknown observation 'rew'", "did you mean 'raw'", "discrete"]),
        ("raw", Wander(beams=720, beam_indices=(0, 720)), ["task.beam_indices has beam 720", "beams 0 to 719"]),
        ("discrete", Wander(beam_indices=(7,)), ["task.beam_indices has beam 7", "beams 0 to 6"]),
        ("raw", Wander(start_clearance=2.0), ["no free space", "task.start_clearance"]),
        ("raw", Wander(start_clearance=0.1), ["task.start_clearance", "turtlebot2's radius, 0.178 m"]),
        ("raw", Wander(field_of_view=4.0), ["task.field_of_view cannot be 4", "turtlebot2's laser sees 3.142 rad"]),
        ("raw", Wander(world="lop"), ["unknown world 'lop'", "did you mean 'loop'"]),
        ("raw", Wander(robot="turtelbot2"), ["unknown robot 'turtelbot2'", "did you mean 'turtlebot2'"]),
        ("raw", ReachGoal(world="loop"), ["world loop has no goal", "task.goal"]),
    ],
)
def test_what_does_not_fit_together_is_refused(mode, task, words):
    with pytest.raises(InputError) as error:
        make_scene(task, mode)
    for word in words:
        assert word in str(error.value)
