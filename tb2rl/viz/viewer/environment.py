"""Pages of an environment that other code steps, and of a policy in a notebook."""

import html
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium

from tb2rl.core.errors import InputError
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.evaluation.episodes import Policy
from tb2rl.runs import config_of, load
from tb2rl.simulation.simulator import default_simulator
from tb2rl.viz.viewer.drive import Drive, Selection
from tb2rl.viz.viewer.page import Page
from tb2rl.viz.viewer.server import ViewerServer
from tb2rl.viz.viewer.training import LoopView


class EnvViewer:
    """Shows an environment with `render_mode="human"`; its `show` is called after each reset and step.

    Args:
        is_paced: Whether to print the page's address, and to wait in `show`, so that steps take as long as on a robot.
    """

    def __init__(self, is_paced: bool = True) -> None:
        self.server, self._is_paced = ViewerServer(), is_paced
        self._view, self._next_time = LoopView(self.server), 0.0
        if is_paced:
            print(f"watch the robot at {self.server.url}", flush=True)
        self._text = self.server.gui.add_markdown("")

    def show(self, env: TurtleBot2Env) -> None:
        """Draw the present state of the environment."""
        if self.server.has_clients:
            self._view.show(env.loop)
            (v, w), steps = env.loop.commands[0].tolist(), int(env.loop.lengths[0])
            self._text.content = f"**Step {steps}**: command v {v:.2f} m/s, w {w:+.2f} rad/s"
        if self._is_paced:
            time.sleep(max(0.0, self._next_time - time.monotonic()))
            self._next_time = time.monotonic() + env.task.control_period

    def close(self) -> None:
        """Close the page."""
        self.server.stop()


@dataclass
class View:
    """A page that a notebook shows as the value of a cell."""

    server: ViewerServer
    height: int = 600  # [px]
    drive: Drive | None = None  # None: an environment that other code steps
    _closed: threading.Event = field(default_factory=threading.Event, init=False, repr=False)

    def __post_init__(self) -> None:
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.server.url

    def _repr_html_(self) -> str:
        return f"<iframe src='{html.escape(self.url)}' style='width:100%;height:{self.height}px;border:0'></iframe>"

    def close(self) -> None:
        """Close the page, and stop driving."""
        self._closed.set()
        self._thread.join()
        self.server.stop()

    def _run(self) -> None:
        if self.drive:
            page = Page(self.server, self.drive)
            self.drive.run(page.show, page.report, lambda: not self._closed.is_set())
            self.drive.close()


def view(policy_or_env: Any, height: int = 600, **settings: Any) -> View:
    """Show a driving policy, or an environment while other code steps it, in a page of the browser. Example::

        tb2rl.view("zoo:navigate-plan-ppo", world="rooms")

    Args:
        policy_or_env: A loaded policy, a reference for `load`, or an environment of tb2rl, maybe wrapped.
        height: Height of the page in the notebook [px].
        settings: Settings of the policy's task to change.

    Returns:
        The page; a notebook shows it, elsewhere open its `url`.

    Raises:
        InputError: If it is neither a policy nor an environment of tb2rl, or a setting does not fit.
    """
    if isinstance(policy_or_env, gymnasium.Env):
        env = policy_or_env.unwrapped
        if not isinstance(env, TurtleBot2Env) or settings:
            raise InputError("view takes an environment of tb2rl without settings; give them to make_env")
        env.viewer = env.viewer or EnvViewer(is_paced=False)
        return View(env.viewer.server, height)
    name = str(policy_or_env) if isinstance(policy_or_env, str | Path) else type(policy_or_env).__name__
    policy: Policy = load(policy_or_env) if isinstance(policy_or_env, str | Path) else policy_or_env
    selection = Selection(policy, config_of(policy).with_task(settings), default_simulator(), name)
    drive = Drive(selection)
    return View(ViewerServer(), height, drive)
