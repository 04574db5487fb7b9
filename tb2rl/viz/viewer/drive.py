"""Live drives: episodes of a policy that the user changes while they run."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import Any, Self

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import EpisodeStart, EpisodeStep, check_spaces, run_single
from tb2rl.runs import Config
from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.simulation.simulator import SimulatorType
from tb2rl.viz.cameras import FilmFrame, goal_of, interpolate_frame, world_of
from tb2rl.viz.viewer.free_commands import KEYS, FreeCommands
from tb2rl.worlds import World
from tb2rl.worlds.goal_paths import OWN_GOAL

FRAME_RATE = 60.0  # frames per second
_PLAN_STEP, _MAX_PLAN = 0.2, 300  # [m] between points of a plan, and most points
NO_GOAL = "this task has no goal; choose the task navigate"
_REST = 1.0  # [s] for which the end of an episode is shown


@dataclass(frozen=True)
class Selection:
    """A policy, its task, and a simulator."""

    policy: Any  # an object with `predict`
    config: Config
    simulator: SimulatorType
    label: str = ""  # name of the policy on the page


class Drive:
    """Simulates one robot in real time. `request` may be called from any thread, everything else from that of `run`.

    Args:
        selection: The policy, the task and the simulator at the start.
        seed: Seed of the first episode; each further episode adds 1.

    Attributes:
        speed: Simulated seconds per second.
        world_index: The world of all episodes; None: the task draws one for each episode.
        step: The latest control step of the episode.
        endings: Numbers of episodes that ended, by reason, since the latest selection.
        policy: The policy that drives.
        observation: The latest observation of the policy.

    Raises:
        InputError: If the policy does not fit the task, or the simulator cannot run.
    """

    step: EpisodeStep
    world_index: int | None

    def __init__(self, selection: Selection, seed: int = 0) -> None:
        self.speed, self.is_paused, self.is_manual, self.seed = 1.0, False, False, seed
        self._requests: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._loop: ControlLoop | None = None
        self.selection, self.world_index = selection, None
        self.select(selection)

    # ---- changes

    def request(self, change: Callable[[], object]) -> None:
        """Make a change before the next frame, in the thread of `run`."""
        self._requests.put(change)

    def select(self, selection: Selection) -> None:
        """Drive another policy, task or simulator; after an `InputError`, the drive is as it was."""
        scene = selection.config.scene.for_purpose("test")
        try:
            check_spaces(selection.policy, scene)
        except InputError:
            message = f"{selection.label} was trained with other observations or actions"
            raise InputError(f"{message}; take the robot as trained, or another policy") from None
        with self._all_or_nothing():
            self.is_manual &= selection.label == self.selection.label
            self.selection, self.world_index, self.endings = selection, None, Counter[str]()
            self._open(scene)
            self._begin()

    def drive_manually(self, is_manual: bool) -> None:
        """Let the user drive, or the policy again, from the present pose."""
        pose, self.is_manual = self.pose, is_manual
        with self._all_or_nothing():
            self._open(self._scene)
            self._begin(pose)

    def press(self, key: str) -> None:
        """Change the user's command by one of `KEYS`; any other key stops the robot."""
        if not self.is_manual:
            self.drive_manually(True)
        command = self._driver.command + KEYS[key] if key in KEYS else np.zeros(2)
        self._driver.command = np.round(self.scene.robot.clip_commands(command), 3)

    def move_goal(self, x: float, y: float) -> None:
        """Continue with another goal [m]; raises an `InputError` if it is in an obstacle, or the task has no goal."""
        if not self.scene.task.goal_task:
            raise InputError(NO_GOAL)
        self.change_world(self.world.with_changes(None, (x, y, 0.0)))

    def move_robot(self, x: float, y: float) -> None:
        """Continue at another position [m]; raises an `InputError` if there is no room for the robot."""
        self._check_room(self.world, x, y)
        self._begin(np.array([x, y, self.pose[2]]))

    def change_world(self, world: World) -> None:
        """Continue in a changed copy of the world, at the present pose.

        Raises:
            InputError: If the task cannot use the world, or the robot touches an obstacle in it.
        """
        pose = self.pose
        self._check_room(world, *pose[:2].tolist())
        fixed_goal = {"goal": None} if hasattr(self.scene.task, "goal") else {}  # or it would replace that of the world
        with self._all_or_nothing():
            self.world_index = None
            self._open(self._scene.in_worlds((world,), **fixed_goal))
            self._begin(pose)

    def choose_world(self, number: int) -> None:
        """Start an episode in one of the worlds, counted from 0 and round again."""
        self.world_index = number % len(self.scene.spec.worlds)
        self._begin()

    def next_episode(self) -> None:
        """Start an episode with the next seed."""
        self.seed += 1
        self._begin()

    def toggle_pause(self) -> None:
        """Pause, or go on."""
        self.is_paused = not self.is_paused

    def step_once(self) -> None:
        """Simulate one control step, and pause."""
        self.is_paused = True
        self._take_step()
        self._time = self._end_time

    # ---- the present

    @property
    def scene(self) -> Scene:
        """The scene, as the simulator has adapted it."""
        assert self._loop is not None, "the constructor opens a loop"
        return self._loop.scene

    @property
    def pose(self) -> np.ndarray:
        """Pose of the robot in the latest frame: x [m], y [m], yaw [rad], shape (3,)."""
        return self.frame.pose

    @property
    def episode_world(self) -> World:
        """The world of the episode."""
        return world_of(self.frame, self.scene)

    @property
    def world(self) -> World:
        """A copy of the world, with the goal of the episode."""
        world, goal = self.episode_world, goal_of(self.scene.task, self.step.after.initial_state)
        return world.with_changes(None, (*goal.tolist(), 0.0)) if np.isfinite(goal).all() else world

    def plan(self) -> np.ndarray:
        """The planned path, if the robot follows one on a known map: x, y [m], shape (n, 2)."""
        task, state, spec = self.scene.task, self.step.after, self.scene.spec
        points = [self.pose[None, :2]]
        if getattr(task, "guide", "") == "plan" and not task.maps_online:
            goal = state.initial_state.world.astype(int), state.initial_state.records["goal_path"].astype(int)
            while len(points) < _MAX_PLAN and np.abs(points[-1] - state.goal).max() > 1e-3:
                points.append(spec.goal_paths.lookahead_point(*goal, points[-1], _PLAN_STEP))
        return np.concatenate(points)

    @property
    def frame(self) -> FilmFrame:
        """The robot at the present time."""
        return interpolate_frame(self.step, self._path, self.scene.task.control_period, self._time)

    # ---- the loop

    def predict(self, observation: Any, **arguments: Any) -> tuple[Any, Any]:
        """The action of the policy that drives."""
        self.observation = observation
        return self.policy.predict(observation, **arguments)

    def run(self, show: Callable[[Self], None], report: Callable[[str], None], is_open: Callable[[], bool]) -> None:
        """Drive while `is_open`; `show` every frame, and `report` changes that are impossible."""
        next_time = time.monotonic()
        while is_open():
            while not self._requests.empty():
                try:
                    self._requests.get()()
                except InputError as error:
                    report(str(error))
            if not self.is_paused:
                self._advance(self.speed / FRAME_RATE)
            show(self)
            next_time = max(next_time + 1 / FRAME_RATE, time.monotonic())
            time.sleep(max(0.0, next_time - time.monotonic()))

    def close(self) -> None:
        """Close the simulator."""
        if self._loop:
            self._loop.close()

    def _advance(self, duration: float) -> None:
        """Advance the time by a duration [s], or by what the computer can simulate in a frame."""
        self._time, deadline = self._time + duration, time.monotonic() + 1 / FRAME_RATE
        while self._time > self._end_time and time.monotonic() < deadline:
            if not self.step.info["ended"]:
                self._take_step()
            elif self._time > self._end_time + _REST * self.speed:
                self.next_episode()
            else:
                return
        if not self.step.info["ended"]:
            self._time = min(self._time, self._end_time)

    @property
    def _end_time(self) -> float:
        """Time of the end of the latest step [s]."""
        return self.step.number * self.scene.task.control_period

    def _take_step(self) -> None:
        if (step := next(self._steps, None)) is None:  # the episode has ended
            self.next_episode()
            return
        self._path.append(step.before.pose[0])
        self.step = step
        if step.info["ended"]:
            self.endings[step.info["ended"]] += 1

    @contextmanager
    def _all_or_nothing(self) -> Iterator[None]:
        """Make changes and close the old control loop, or, after an `InputError`, undo them and close the new one."""
        before, old_loop = dict(vars(self)), self._loop
        unused_loop = old_loop
        try:
            yield
        except InputError:
            unused_loop = self._loop
            vars(self).update(before)
            raise
        finally:
            if unused_loop and unused_loop is not self._loop:
                unused_loop.close()

    def _open(self, scene: Scene) -> None:
        """Open a control loop for a scene."""
        driver = FreeCommands(scene.actions)
        actions: Any = driver if self.is_manual else scene.actions
        self._loop = ControlLoop.open(replace(scene, actions=actions), self.selection.simulator)
        self._scene, self._driver = scene, driver
        self.policy = driver if self.is_manual else self.selection.policy

    def _begin(self, pose: np.ndarray | None = None) -> None:
        """Start an episode, at a pose (3,) or where the task draws one."""
        scene, rng = self.scene, np.random.default_rng(self.seed)
        spec = scene.spec if self.world_index is None else scene.spec.for_world(self.world_index)
        initial_state = scene.task.randomized_initial_state(spec, GeneratorSource(rng))
        if pose is not None:
            initial_state.pose[:] = pose
            if scene.task.goal_task and len(spec.worlds) == 1 and (goal := spec.worlds[0].goal):
                initial_state.goal[:], initial_state.records["goal_path"] = goal[:2], OWN_GOAL
        assert self._loop is not None, "`_open` opens it"
        self._steps = run_single(self._loop, self, EpisodeStart(0, self.seed, initial_state, rng))
        self._path: list[np.ndarray] = []
        self._time = 0.0
        self._take_step()

    def _check_room(self, world: World, x: float, y: float) -> None:
        if not world.contains((x, y)) or world.clearance(x, y) < self.scene.robot.radius:
            raise InputError("there would be no room for the robot; choose another place")
