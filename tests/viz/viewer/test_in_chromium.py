"""Everything that a user does on the viewer's page, in a real Chromium."""

import io
import math
import time
from functools import partial
from threading import Thread

import numpy as np
import pytest
from PIL import Image
from selenium.webdriver import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from tb2rl import make_env, view
from tb2rl.runs import Run, resolve
from tb2rl.training.training import train_config
from tb2rl.viz.viewer.server import ViewerServer
from tb2rl.viz.viewer.training import TrainingViewer

pytestmark = [pytest.mark.slow, pytest.mark.flaky(reruns=2)]  # a busy software renderer misses clicks
SHORT = {"train.simulation": "kinematic", "train.total_timesteps": 200_000, "train.n_envs": 4, "train.eval_freq": 0}
POLICY, CANVAS = "zoo:navigate-plan-ppo", "canvas[data-engine]"


def eventually(condition, seconds: float = 120.0):
    """Wait until a condition holds, and return its value."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, "the condition did not come true"
        time.sleep(0.05)
    return value


def picture_of(browser) -> np.ndarray:
    """Pixels of the 3D scene, shape (height, width, 3)."""
    canvas = browser.find_element(By.CSS_SELECTOR, CANVAS)
    return np.asarray(Image.open(io.BytesIO(canvas.screenshot_as_png)).convert("RGB")).astype(float)


def is_near_goal(drive, point) -> bool:
    return math.dist(drive.step.after.goal[0], point) < 0.2


def distance(drive, point) -> float:
    return math.dist(drive.pose[:2], point)


def test_the_robot_moves_pauses_and_steps(watch):
    page = watch("zoo:maze-loop-qlearn")
    first = picture_of(page.browser)
    eventually(lambda: np.abs(picture_of(page.browser) - first).max() > 50)
    page.press("Pause / go on")
    page.eventually(lambda: page.drive.is_paused)
    number, seed = page.drive.step.number, page.drive.seed
    page.press("One step")
    page.eventually(lambda: page.drive.step.number == number + 1)
    page.press("Pause / go on")
    page.eventually(lambda: page.drive.step.number > number + 3)
    page.press("New episode")
    page.eventually(lambda: page.drive.seed == seed + 1)


def test_the_robot_drives_to_a_dragged_goal_and_around_a_new_wall(watch):
    page = watch(POLICY, world="loop")
    page.drive.is_paused = True
    page.drive.request(lambda: page.drive.move_goal(3.0, -0.6))  # where nothing covers it
    page.eventually(partial(is_near_goal, page.drive, (3.0, -0.6)))
    is_moved = partial(is_near_goal, page.drive, (1.0, -2.0))
    page.until(is_moved, lambda: page.drag(page.drive.world.goal[:2], (1.0, -2.0)))
    x, y = page.drive.pose[:2]
    boxes = len(page.drive.world.boxes)
    middle = (x + 1.0) / 2, (y - 2.0) / 2
    page.press("add a wall")
    across = np.array([2.0 + y, 1.0 - x]) / math.hypot(2.0 + y, 1.0 - x)  # to the left of the way
    ends = [np.array(middle) + side * across for side in (-0.6, 0.6)]
    page.until(lambda: len(page.drive.world.boxes) > boxes, lambda: [page.click(*end) for end in ends])
    page.drive.speed, page.drive.is_paused = 20.0, False
    ended = page.eventually(lambda: page.drive.step.info["ended"])
    assert ended == "goal"
    assert page.messages == []


def test_clicks_move_the_goal_and_the_robot_and_remove_a_post(watch):
    page = watch(POLICY, world="loop")
    page.drive.is_paused = True
    page.until(partial(is_near_goal, page.drive, (1.0, -2.0)), lambda: page.click(1.0, -2.0))
    page.press("move the robot")
    page.until(lambda: distance(page.drive, (-1.5, 1.5)) < 0.2, lambda: page.click(-1.5, 1.5))
    page.press("add a post")
    page.until(lambda: len(page.drive.world.posts) >= 1, lambda: page.click(0.0, -3.0))
    page.press("remove a wall or post")
    page.until(lambda: len(page.drive.world.posts) == 0, lambda: page.click(0.0, -3.0))


def test_policy_world_robot_and_simulator_are_swapped(watch):
    page = watch("zoo:maze-loop-qlearn")
    page.choose("Policy", "zoo:anywhere-ppo")
    page.eventually(lambda: page.drive.selection.label == "zoo:anywhere-ppo")
    page.choose("World", "circuit")
    page.eventually(lambda: page.drive.episode_world.name == "circuit")
    page.choose("Robot", "turtlebot3")
    eventually(lambda: "other observations" in "".join(page.messages))
    assert page.drive.scene.robot.name == "turtlebot2", "the policy does not fit the robot"
    eventually(lambda: page.chosen("Robot") == "as trained")
    page.choose("Policy", "wallfollower (a rule)")
    page.eventually(lambda: page.drive.selection.label == "wallfollower")
    page.choose("Robot", "turtlebot3")
    page.eventually(lambda: page.drive.scene.robot.name == "turtlebot3")
    page.choose("Simulator", "mujoco")
    page.eventually(lambda: page.drive.selection.simulator.name == "mujoco")
    page.choose("World", "generated: rooms")
    page.eventually(lambda: page.drive.episode_world.name.startswith("rooms"))
    page.choose("Robot", "as trained")
    page.eventually(lambda: page.drive.scene.robot.name == "turtlebot2")
    assert "A rule, which has learned nothing." in page.browser.find_element(By.TAG_NAME, "body").text
    page.choose("Policy", "zoo:maze-loop-qlearn")
    page.eventually(lambda: page.drive.selection.label == "zoo:maze-loop-qlearn")
    page.choose("Task", "drive")
    page.eventually(lambda: page.drive.selection.config.task_name == "drive")
    assert page.drive.selection.label.startswith("zoo:"), "a policy that was trained at this task"
    assert len(page.messages) == 1


def test_the_user_drives_by_keys_and_buttons(watch):
    page = watch("zoo:maze-loop-qlearn", start="fixed")
    keys = ActionChains(page.browser)
    page.browser.find_element(By.CSS_SELECTOR, CANVAS).click()
    keys.send_keys("w", Keys.ARROW_UP, "d").perform()
    page.eventually(lambda: page.drive.is_manual and page.drive.step.command.tolist() == [0.2, -0.5])
    page.press("stop")
    page.eventually(lambda: page.drive.step.command.tolist() == [0.0, 0.0])
    page.press("Let the policy drive")
    page.eventually(lambda: not page.drive.is_manual and page.drive.step.command[0] > 0.0)


def test_several_pages_a_reload_and_no_page(watch):
    page = watch("zoo:maze-loop-qlearn")
    first = page.browser.current_window_handle
    page.browser.switch_to.new_window("tab")
    page.browser.get(page.server.url)
    eventually(lambda: len(page.server.get_clients()) == 2)
    page.press("Pause / go on")
    page.browser.switch_to.window(first)
    eventually(lambda: "(paused)" in page.browser.find_element(By.TAG_NAME, "body").text)
    page.press("Pause / go on")
    page.open()  # reload
    pages = page.browser.window_handles
    page.browser.switch_to.new_window("tab")
    last = page.browser.current_window_handle
    for handle in pages:
        page.browser.switch_to.window(handle)
        page.browser.close()
    page.browser.switch_to.window(last)
    eventually(lambda: not page.server.get_clients())
    frames, number = page.frames, page.drive.step.number
    eventually(lambda: page.frames > frames + 30 and page.drive.step.number != number)


def test_environments_that_train_and_their_curves(browser, tmp_path):
    """The page is open from the start; the training goes on when it closes."""
    server = ViewerServer(port=0)
    viewer = TrainingViewer(server)
    config = resolve("qlearn", "maze", settings=SHORT)
    browser.get(server.url)
    eventually(lambda: server.has_clients)
    training = Thread(target=train_config, args=(config, tmp_path / "run"), kwargs={"watchers": [viewer]})
    training.start()
    try:
        eventually(lambda: "control steps" in browser.find_element(By.TAG_NAME, "body").text)
        first = picture_of(browser)
        eventually(lambda: np.abs(picture_of(browser) - first).max() > 50)
        eventually(lambda: "success" in browser.find_element(By.TAG_NAME, "body").text)
        browser.get("about:blank")
    finally:
        training.join()
        server.stop()
    assert Run.open(tmp_path / "run").checkpoints


def test_an_environment_that_other_code_steps(browser):
    env = make_env("maze", simulation="kinematic")
    page = view(env)
    browser.get(page.url)
    eventually(lambda: page.server.has_clients)
    env.reset(seed=0)
    env.step(0)
    eventually(lambda: "Step 1" in browser.find_element(By.TAG_NAME, "body").text)
    first = picture_of(browser)
    for _ in range(5):
        env.step(0)
    eventually(lambda: np.abs(picture_of(browser) - first).max() > 50)
    browser.get("about:blank")
    page.close()
