"""The controls of the viewer's page: playback, policy, task, world, mouse and keys."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from tb2rl.core import InputError, robot_names, task_names
from tb2rl.core.values import Point
from tb2rl.runs import HUB
from tb2rl.simulation.variation import PRESETS
from tb2rl.viz.viewer import choices
from tb2rl.viz.viewer.choices import AS_TRAINED
from tb2rl.viz.viewer.drive import NO_GOAL, Drive, Selection
from tb2rl.viz.viewer.live_scene import LiveScene
from tb2rl.viz.viewer.server import ViewerServer
from tb2rl.worlds.edits import add_post, add_wall, hit_floor, remove_obstacle

_SPEEDS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)  # simulated seconds per second
_MAX_PEOPLE, _MAX_SEED = 8, 100_000
_MOVE_GOAL, _MOVE_ROBOT = "move the goal", "move the robot"  # meanings of a click
_ADD_WALL, _ADD_POST, _REMOVE = "add a wall", "add a post", "remove a wall or post"
_HINTS = {
    _MOVE_GOAL: "Click on the floor, or drag the green disc.",
    _MOVE_ROBOT: "Click on the floor, or drag the robot.",
    _ADD_WALL: "Click where the wall begins, then where it ends, both away from the robot.",
    _ADD_POST: "Click on the floor, away from the robot.",
    _REMOVE: "Click on it.",
}
_NO_CLICK_HINT = "**A click does nothing yet.** Choose what it does. For a goal, choose the task navigate."
_STEERING = {"accelerate": "W", "brake": "S", "turn left": "A", "turn right": "D", "stop": ""}
_KEYS_HINT = "W A S D or arrows, space stops. If keys do nothing, click on this text first."
_HOTKEYS = {"W": "arrowup", "S": "arrowdown", "A": "arrowleft", "D": "arrowright", "": "space"}


class Controls:
    """Controls of a `Drive`. Pages can send any values, so all of them are checked in the thread of the drive.

    Args:
        server: The server of the page.
        drive: The drive.
        follow: Whether the camera follows the robot.
    """

    def __init__(self, server: ViewerServer, drive: Drive, follow: bool) -> None:
        self._server, self._drive = server, drive
        self._gui: Any = server.gui
        self._wall_start: Point | None = None
        self._click = ""  # meaning of a click
        self._has_goal: bool | None = None  # whether the task had a goal when the meaning was set
        first = drive.selection
        task = first.config.task_name if choices.is_baseline(first.label) else ""
        self._loaded = {(first.label, task): first}  # by name, and by task if the policy can be given any
        self._add_playback(follow)
        self._add_world()
        self._add_mouse()
        self._add_policy()
        self._selected = self._values()
        self._defaults: list[tuple[Any, Any]] = [pair for pair in self._selected if pair[0] is not self._simulation]
        self._adapt_controls()

    @property
    def follows(self) -> bool:
        """Whether the camera follows the robot."""
        return bool(self._follow.value)

    def attach(self, live: LiveScene) -> None:
        """Let the user drag the goal and the robot of a scene."""
        for handle, move in ((live.goals, self._drive.move_goal), (live.robots, self._drive.move_robot)):
            handle.on_drag("left")(partial(self._on_drag, move))

    def visit(self, policy: str, world: str) -> None:
        """Select a policy and a world, and everything else as at the start."""
        for handle, value in self._defaults:
            handle.value = value
        self._policy.value, self._world.value = choices.option_of(policy), world
        self._select()
        self._selected = self._values()

    def request(self, change: Callable[..., object], *arguments: Any) -> None:
        """Call a function in the thread of the drive."""
        self._drive.request(partial(change, *arguments))

    # ---- playback

    def _add_playback(self, follow: bool) -> None:
        drive = self._drive
        changes: dict[str, Callable[[], object]] = {
            "Pause / go on": drive.toggle_pause,
            "One step": drive.step_once,
            "New episode": drive.next_episode,
        }
        with self._gui.add_folder("Time"):
            buttons = self._gui.add_button_group("Playback", list(changes))
            speeds = {f"{speed:g} x": speed for speed in sorted({*_SPEEDS, drive.speed})}
            speed = self._gui.add_dropdown("Speed, 0.25 to 20 x", list(speeds), initial_value=f"{drive.speed:g} x")
            self._follow = self._gui.add_checkbox("Follow the robot", initial_value=follow)
        buttons.on_click(lambda _: self.request(changes.get(buttons.value, lambda: None)))
        speed.on_update(lambda _: setattr(drive, "speed", speeds.get(speed.value, drive.speed)))

    # ---- policy, task and world

    def _add_policy(self) -> None:
        selection = self._drive.selection
        with self._gui.add_folder("Policy and task"):
            options = list(map(choices.option_of, choices.policy_names()))
            self._policy = self._add_choice("Policy", options, choices.option_of(selection.label))
            self._description = self._gui.add_markdown("")
            self._task = self._add_choice("Task", task_names(), selection.config.task_name)
            self._robot = self._add_choice("Robot", robot_names())
            self._simulation = self._add_choice("Simulator", choices.simulators(), selection.simulator.name)
            with self._gui.add_folder("Policy of Hugging Face", expand_by_default=False):
                self._hub = self._gui.add_text("hf:USER/REPOSITORY", initial_value="")
                load = self._gui.add_button("Load this policy")
        for handle in (self._policy, self._robot, self._simulation):
            self._on_update(handle, self._select)
        load.on_click(lambda _: self.request(self._select_from_hub))
        self._on_update(self._task, self._select_task)

    def _add_world(self) -> None:
        gui = self._gui
        with gui.add_folder("World: make it harder or easier"):
            gui.add_markdown("A change begins a new episode. Difficulty chooses a generated world.")
            self._world = self._add_choice("World", choices.worlds())
            self._difficulty = gui.add_slider("Difficulty", min=0.0, max=1.0, step=0.05, initial_value=0.5)
            self._number = gui.add_number("World number (seed)", initial_value=0, min=0, max=_MAX_SEED, step=1)
            self._people = gui.add_slider("People who walk", min=0, max=_MAX_PEOPLE, step=1, initial_value=0)
            self._variation = self._add_choice("Variation (noise, wear)", [*PRESETS])
        for handle in (self._world, self._people, self._variation):
            self._on_update(handle, self._select)
        self._on_update(self._difficulty, self._select_difficulty)
        self._on_update(self._number, self._select_number)

    def _adapt_controls(self) -> None:
        """Adapt texts and controls to the policy, the task and the world."""
        has_numbers = choices.is_generated(self._world.value) or len(self._drive.scene.spec.worlds) > 1
        self._number.disabled = not has_numbers
        self._description.content = choices.describe(self._drive.selection)
        if self._drive.scene.task.goal_task != self._has_goal:
            self._has_goal = self._drive.scene.task.goal_task
            self._set_click(_MOVE_GOAL if self._has_goal else "")

    def _add_choice(self, label: str, names: list[str], value: str = AS_TRAINED) -> Any:
        options = list(dict.fromkeys([value, *names]))
        return self._gui.add_dropdown(label, options, initial_value=value)

    def _on_update(self, handle: Any, select: Callable[[], None]) -> None:
        """Select when a page, not this program, has changed a control; the controls follow what is possible."""

        def change() -> None:
            chosen = self._values()  # now, because the user can change others while this selection is loaded
            try:
                select()
            except InputError:
                for each, value in self._selected:
                    each.value = value
                raise
            adapted = (self._policy, self._task, self._world)  # to another control, by the selection
            self._selected = [(each, each.value if each in adapted else value) for each, value in chosen]

        handle.on_update(lambda event: self.request(change) if event.client is not None else None)

    def _values(self) -> list[tuple[Any, Any]]:
        """The controls that select, each with its value."""
        handles = [self._policy, self._task, self._robot, self._simulation]
        handles += [self._world, self._difficulty, self._number, self._people, self._variation]
        return [(handle, handle.value) for handle in handles]

    def _select(self, policy: str | None = None) -> None:
        """Drive what the controls say; after an `InputError`, the drive is as it was."""
        for handle in (self._policy, self._task, self._robot, self._simulation, self._world, self._variation):
            if handle.value not in handle.options:
                raise InputError(f"there is no {handle.label} {handle.value!r}")
        settings: dict[str, Any] = {}
        for key, handle in (("robot", self._robot), ("variation", self._variation)):
            settings |= {} if handle.value == AS_TRAINED else {key: handle.value}
        if self._world.value != AS_TRAINED:
            difficulty, seed = float(np.clip(self._difficulty.value, 0.0, 1.0)), int(self._number.value)
            settings["world"] = choices.world_setting(self._world.value, difficulty, max(0, min(seed, _MAX_SEED)))
        if self._people.value:
            settings["dynamic_obstacles"] = {"people": max(1, min(int(self._people.value), _MAX_PEOPLE))}
        name = policy or choices.policy_of(self._policy.value)
        with self._loading(name):
            self._drive.select(self._make_selection(name, settings))
        self._task.value = self._drive.selection.config.task_name
        self._adapt_controls()

    def _make_selection(self, name: str, settings: dict[str, Any]) -> Selection:
        """A policy with changed settings; its own settings, and those of the command line, are kept."""
        key, simulator = (name, self._task.value if choices.is_baseline(name) else ""), self._simulation.value
        if key not in self._loaded:
            self._loaded[key] = choices.make_selection(name, self._task.value, {}, simulator)
        return choices.with_settings(self._loaded[key], settings, simulator)

    def _select_task(self) -> None:
        """Drive a policy of the chosen task, unless the present one can do it."""
        selection = self._drive.selection
        if self._task.value != selection.config.task_name and not choices.is_baseline(selection.label):
            self._policy.value = choices.option_of(choices.policy_of_task(self._task.value))
        self._select()

    def _select_from_hub(self) -> None:
        if not self._hub.value.startswith(HUB):
            raise InputError("a policy on the hub is hf:USER/REPOSITORY")
        self._select(self._hub.value)
        self._policy.options = list(dict.fromkeys([*self._policy.options, self._hub.value]))
        self._policy.value = self._hub.value

    def _select_difficulty(self) -> None:
        """Drive in a generated world, because others have no difficulty."""
        if not choices.is_generated(self._world.value):
            self._world.value = choices.MIXED
        self._select()

    def _select_number(self) -> None:
        if choices.is_generated(self._world.value):
            self._select()
        else:
            self._drive.choose_world(int(self._number.value))

    @contextmanager
    def _loading(self, name: str) -> Iterator[None]:
        """Show that a policy is being loaded, which can take seconds."""
        clients = self._server.get_clients().values()
        notes = [client.add_notification("Loading", name, loading=True, with_close_button=False) for client in clients]
        try:
            yield
        finally:
            for note in notes:
                note.remove()

    # ---- mouse and keys

    def _add_mouse(self) -> None:
        drive = self._drive
        self._clicks: dict[str, Callable[[Point, Any, Any], object]] = {
            _MOVE_GOAL: lambda point, *_: drive.move_goal(*point),
            _MOVE_ROBOT: lambda point, *_: drive.move_robot(*point),
            _ADD_WALL: self._add_wall,
            _ADD_POST: lambda point, *_: drive.change_world(add_post(drive.world, point)),
            _REMOVE: lambda _, *ray: drive.change_world(remove_obstacle(drive.world, *ray)),
        }
        with self._gui.add_folder("Goal, walls and posts"):
            buttons = self._gui.add_button_group("Let a click", list(self._clicks))
            self._hint = self._gui.add_markdown("")
            undo = self._gui.add_button("Undo walls, posts and goal")
        undo.on_click(lambda _: self.request(lambda: drive.select(drive.selection)))
        buttons.on_click(lambda _: self.request(self._set_click, buttons.value))

        def click(*ray: Any) -> None:
            if (point := hit_floor(*ray)) and self._click in self._clicks:
                self._clicks[self._click](point, *ray)

        on_click: Any = self._server.scene.on_click()
        on_click(lambda event: self.request(click, event.ray_origin, event.ray_direction))

    def _set_click(self, meaning: str) -> None:
        if meaning == _MOVE_GOAL and not self._has_goal:
            raise InputError(NO_GOAL)
        hint = f"**A click will {meaning}.** {_HINTS[meaning]}" if meaning in _HINTS else _NO_CLICK_HINT
        self._click, self._hint.content = meaning, hint

    def _add_wall(self, point: Point, *_: Any) -> None:
        """Start a wall at a point, or end it there."""
        start, self._wall_start = self._wall_start, None
        if start:
            self._drive.change_world(add_wall(self._drive.world, start, point))
        else:
            self._wall_start = point
            self._server.scene.add_icosphere("/wall", 0.08, color=(200, 60, 40), position=(*point, 0.1))

    def _on_drag(self, move: Callable[[float, float], None], event: Any) -> None:
        camera = np.array(event.client.camera.position)
        point = hit_floor(camera, np.array(event.end_position) - camera)
        if event.phase == "end" and point and math.isfinite(sum(point)):
            self.request(move, *point)

    def add_steering(self) -> None:
        """Add the keys and buttons by which the user drives."""
        gui, drive = self._gui, self._drive
        with gui.add_folder("Drive yourself"):
            gui.add_markdown(_KEYS_HINT)
            steering = gui.add_button_group("Steer", list(_STEERING))
            back = gui.add_button("Let the policy drive")
        steering.on_click(lambda _: self.request(drive.press, _STEERING.get(steering.value, "")))
        back.on_click(lambda _: self.request(drive.drive_manually, False))
        for label, key in _STEERING.items():
            for hotkey in filter(None, (key, _HOTKEYS[key])):
                command = gui.add_command(f"{label} ({hotkey})", hotkey=hotkey)
                command.on_trigger(lambda _, key=key: self.request(drive.press, key))
