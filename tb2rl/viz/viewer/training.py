"""A page with the environments that a training steps, and its learning curves."""

import time
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from viser import uplot

from tb2rl.envs.control_loop import ControlLoop
from tb2rl.rendering.colours import GOAL, PATH
from tb2rl.viz.viewer.live_scene import LiveScene
from tb2rl.viz.viewer.server import ViewerServer

_FRAME_PERIOD, _CURVE_PERIOD, _WORLD_PERIOD = 0.05, 1.0, 3.0  # [s] between updates
_MAX_ROBOTS, _MAX_WORLDS = 64, 9  # most robots in one world, and most worlds side by side


class TrainingViewer(BaseCallback):
    """Shows some of the environments that train, while anybody has opened the page.

    Args:
        server: The server of the page.
    """

    def __init__(self, server: ViewerServer) -> None:
        super().__init__()
        self._server, self._live = server, LoopView(server)
        self._next_frame = self._next_curve = 0.0
        self._curves: list[tuple[float, float, float]] = []  # timesteps, mean return, success rate [%]
        server.gui.main_panel.dock_right()
        self._text = server.gui.add_markdown("The training begins.")
        self._slow = server.gui.add_checkbox("Slow down to real time", initial_value=False)
        self._return = _add_curve(server, "Return of the latest episodes", PATH)
        self._success = _add_curve(server, "Success of the latest episodes [%]", GOAL)

    def _on_step(self) -> bool:
        if self._server.has_clients and (now := time.monotonic()) >= self._next_frame:
            self._next_frame = now + _FRAME_PERIOD
            self._show(now)
        return True

    def _show(self, now: float) -> None:
        env: Any = self.training_env.unwrapped
        loop: ControlLoop = env.loop
        self._live.show(loop)
        if self._slow.value:
            time.sleep(loop.task.control_period)
            self._next_frame = 0.0
        if now >= self._next_curve:
            self._next_curve = now + _CURVE_PERIOD
            self._show_curves()

    def _show_curves(self) -> None:
        episodes, successes = self.model.ep_info_buffer or (), self.model.ep_success_buffer or ()
        text = f"**{self.num_timesteps:,} control steps**, {self.training_env.num_envs} environments"
        if episodes:
            mean_return = float(np.mean([episode["r"] for episode in episodes]))
            success = 100.0 * float(np.mean(successes)) if successes else 0.0
            self._curves.append((float(self.num_timesteps), mean_return, success))
            timesteps, returns, rates = (np.array(column) for column in zip(*self._curves, strict=True))
            if len(timesteps) > 1:
                self._return.data, self._success.data = (timesteps, returns), (timesteps, rates)
            text += f"\n\nThe latest {len(episodes)} episodes: return {mean_return:.4g}, {success:.0f} % success"
        self._text.content = text


class LoopView:
    """Draws environments of a control loop: up to 64 robots in a world that they share, or 9 worlds side by side."""

    def __init__(self, server: ViewerServer) -> None:
        self._server = server
        self._live: LiveScene | None = None
        self._next_worlds = 0.0

    def show(self, loop: ControlLoop) -> None:
        """Draw the present state; worlds that episodes have left are replaced every three seconds."""
        state, spec, now = loop.robot_state, loop.scene.spec, time.monotonic()
        is_shared = len(spec.worlds) == 1 and state.dynamic_obstacles is None
        count = min(loop.num_envs, _MAX_ROBOTS if is_shared else _MAX_WORLDS)
        worlds = [spec.worlds[index] for index in state.initial_state.world[:count].astype(int).tolist()]
        if self._live is None or (self._live.worlds != worlds and now >= self._next_worlds):
            self._next_worlds, is_first = now + _WORLD_PERIOD, self._live is None
            self._live = LiveScene(self._server, loop.scene.robot, worlds, shared=is_shared)
            self._poses, self._goals = np.zeros((count, 3)), np.full((count, 2), np.nan)
            if is_first:
                self._live.set_cameras()
        is_shown = [world is shown for world, shown in zip(worlds, self._live.worlds, strict=True)]
        self._poses[is_shown] = state.pose[:count][is_shown]
        if loop.task.goal_task:
            self._goals[is_shown] = state.goal[:count][is_shown]
        outlines = None if state.dynamic_obstacles is None else state.dynamic_obstacles[:count]
        with self._server.atomic():
            self._live.show_robots(self._poses, self._goals, outlines)
            if count == 1:
                self._live.show_beams(state.pose[0], loop.scene.laser.angles, state.ranges[0])


def _add_curve(server: ViewerServer, title: str, colour: str) -> Any:
    series = uplot.Series(label="control steps"), uplot.Series(label=title, stroke=colour, width=2)
    scales = {"x": uplot.Scale(time=False)}
    return server.gui.add_uplot((np.zeros(2), np.zeros(2)), series, title=title, scales=scales, aspect=1.6)
