"""Live drives: what the user changes while the robot drives."""

from types import SimpleNamespace

import numpy as np
import pytest

from tb2rl import InputError
from tb2rl.viz.film import FilmOptions, open_episodes
from tb2rl.viz.viewer.choices import AS_TRAINED, make_selection
from tb2rl.viz.viewer.controls import Controls
from tb2rl.viz.viewer.drive import Drive
from tb2rl.viz.viewer.server import ViewerServer
from tb2rl.viz.viewer.status import status
from tb2rl.worlds import edits


@pytest.fixture
def drive():
    """A function that starts a drive of an agent that does not learn."""
    drives = []

    def start(policy: str = "wallfollower", task: str = "maze", simulation: str = "kinematic", **settings) -> Drive:
        drives.append(Drive(make_selection(policy, task, {"start": "fixed", **settings}, simulation)))
        return drives[-1]

    yield start
    for each in drives:
        each.close()


def run_until(drive: Drive, condition, frames: int = 2000) -> None:
    """Show frames, at the drive's speed, until a condition holds."""
    shown = iter(range(frames))
    drive.run(lambda _: next(shown), pytest.fail, lambda: not condition())


def test_the_drive_is_that_of_a_film_with_the_same_seed(drive):
    live = drive(world="mixed", start="random")
    options = FilmOptions(steps=live.scene.task.episode_steps, simulation="kinematic")
    with open_episodes(live.policy, live.selection.config, None, options, "") as (_, episodes):
        filmed = [step.after.pose for _, step in zip(range(3), next(episodes), strict=False)]
    for pose in filmed:
        assert live.step.after.pose == pytest.approx(pose, abs=0)
        live.step_once()


@pytest.mark.parametrize("speed", [0.25, 1.0, 8.0])
def test_frames_are_in_real_time_at_any_speed(drive, speed):
    live = drive(simulation="kinematic")
    live.speed = speed
    run_until(live, lambda: live.frame.time > 0.0)
    assert live.frame.time == pytest.approx(speed / 60, rel=1e-6)


def test_the_goal_moves_while_the_robot_stays(drive):
    live = drive("pursuit", "navigate", world="wall", guide="plan")
    live.step_once()
    pose = live.pose.copy()
    live.move_goal(1.0, -1.0)
    assert live.world.goal[:2] == (1.0, -1.0)
    assert live.step.before.pose[0] == pytest.approx(pose, abs=0.02)
    live.speed, live.is_paused = 20.0, False
    run_until(live, lambda: live.step.info["ended"])
    assert live.step.info["ended"] == "goal"


@pytest.mark.parametrize("simulation", ["kinematic", "mujoco", pytest.param("bullet", marks=pytest.mark.bullet)])
def test_a_wall_stops_the_robot_that_ran_ahead(drive, simulation):
    live = drive("random", world="wall", simulation=simulation)
    x, y, yaw = live.pose
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    middle = np.array([x, y]) + 0.7 * ahead
    live.change_world(edits.add_wall(live.world, tuple(middle - left), tuple(middle + left)))
    assert live.step.after.nearest_range[0] < 0.8


def test_a_wall_is_not_put_on_the_robot_and_the_drive_goes_on(drive):
    live = drive()
    world, (x, y) = live.episode_world, live.pose[:2]
    with pytest.raises(InputError, match="no room for the robot"):
        live.change_world(edits.add_post(live.world, (x, y)))
    with pytest.raises(InputError, match="no room for the robot"):
        live.move_robot(100.0, 0.0)
    with pytest.raises(InputError, match="has no goal; choose the task navigate"):
        live.move_goal(0.0, 0.0)
    live.step_once()
    assert live.episode_world is world


def test_the_user_drives_and_the_task_judges_the_nearest_action(drive):
    live = drive()
    live.press("W")
    live.press("A")
    live.step_once()
    assert live.step.command.tolist() == [0.1, 0.5]
    assert live.step.action == 1  # left
    live.press(" ")
    live.step_once()
    assert live.step.command.tolist() == [0.0, 0.0]
    live.drive_manually(False)
    live.step_once()
    assert live.step.command[0] >= 0.05


def test_a_request_that_is_impossible_is_reported_and_the_drive_goes_on(drive):
    live, messages, shown = drive(), [], iter(range(10_000))
    live.request(lambda: live.move_goal(0.0, 0.0))
    live.request(lambda: live.move_robot(100.0, 0.0))
    live.run(lambda _: next(shown), messages.append, lambda: len(messages) < 2)
    assert len(messages) == 2


def test_another_policy_that_does_not_fit_leaves_the_drive_as_it_is(drive):
    live = drive()
    step, selection = live.step, live.selection
    with pytest.raises(InputError, match="trained with other observations or actions"):
        live.select(make_selection("zoo:maze-loop-ppo", "maze", {"beams": 5}, "kinematic"))
    assert (live.step, live.selection) == (step, selection)


@pytest.mark.parametrize("is_manual", [False, True])
def test_a_post_that_leaves_no_room_for_starts_leaves_the_drive_as_it_is(drive, is_manual):
    live = drive(world="wall", start="random")
    live.drive_manually(is_manual)
    step, world = live.step, live.episode_world
    x, y, _ = world.start
    with pytest.raises(InputError, match=r"nearer than 0\.6 m"):
        live.change_world(edits.add_post(live.world, (x, y + 0.4)))
    assert (live.step, live.episode_world) == (step, world)
    live.step_once()
    live.press("W")
    live.step_once()
    assert live.step.command.tolist() == [0.1, 0.0]


def test_a_world_of_many_is_chosen_by_number(drive):
    live = drive("random", world={"generator": "rooms", "worlds": 3})
    for number in (4, 2):
        live.choose_world(number)
        assert live.episode_world.name == f"rooms {number % 3} (test)"


def test_the_observation_is_that_of_the_policys_latest_decision(drive):
    live = drive()
    assert live.observation in live.scene.observation_space
    assert live.policy.predict(live.observation)[0] == live.step.action


def test_the_page_tells_what_the_robot_does_and_how_its_episodes_ended(drive):
    live = drive("random", episode_steps=3)
    for _ in range(4):
        live.step_once()
    assert live.endings == {"time limit": 1}
    assert "**episodes so far:** time limit 1" in status(live)
    live = drive()
    live.drive_manually(True)
    live.step_once()
    assert "**Doing:** standing still (paused); 0.00 m/s, +0.00 rad/s" in status(live)
    for key, motion in (("A", "turning on the spot to the left"), ("W", "driving forward, turning to the left")):
        live.press(key)
        live.step_once()
        assert f"**Doing:** {motion} (paused); " in status(live)


def change(handle, value) -> None:
    """Change a control as a page does."""
    handle._impl.value = value
    for callback in handle._impl.update_cb:
        callback(SimpleNamespace(client=object()))


@pytest.fixture
def server():
    server = ViewerServer(port=0)
    yield server
    server.stop()


def test_a_choice_while_another_one_is_loaded_is_undone_alone(drive, server):
    live, messages = drive(simulation="kinematic"), []
    controls = Controls(server, live, follow=False)

    def choose_robot_while_loading(selection) -> None:
        if controls._robot.value == AS_TRAINED:
            change(controls._robot, "unknown")
        select(selection)

    select, live.select = live.select, choose_robot_while_loading
    change(controls._variation, "mild")
    frames = iter(range(600))
    live.run(lambda _: next(frames), messages.append, lambda: not messages)
    assert (controls._variation.value, controls._robot.value) == ("mild", AS_TRAINED)


def test_a_difficulty_leads_to_a_generated_world_and_clicks_are_those_of_the_task(drive, server):
    live = drive("random", simulation="kinematic")
    controls = Controls(server, live, follow=False)
    assert controls._hint.content.startswith("**A click does nothing yet.**"), "the task has no goal"
    assert controls._description.content == "A rule, which has learned nothing."
    change(controls._difficulty, 0.8)
    change(controls._task, "navigate")
    run_until(live, lambda: live.selection.config.task_name == "navigate")
    assert controls._world.value == "generated: mixed"
    assert live.selection.config.task.world["difficulty"] == (0.8, 0.8)
    assert controls._hint.content.startswith("**A click will move the goal.**")
    change(controls._policy, "zoo:maze-loop-qlearn")
    run_until(live, lambda: live.selection.label == "zoo:maze-loop-qlearn")
    assert controls._description.content == "Learned by qlearn at task maze, in loop."
