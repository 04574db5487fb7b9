"""Episodes of a policy to film, record or watch: options, environment and control steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm  # type: ignore[import-untyped]

from tb2rl.core.errors import InputError, unknown
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.moments import LARGEST_SEED, Moment, roll_out, time_limit
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.spaces import check_observes
from tb2rl.runs.config import Config
from tb2rl.runs.loading import config_of, load
from tb2rl.simulation import SimulatorType, default_simulator, find_simulator
from tb2rl.viz.cameras import CAMERAS

STEPS = 300  # control steps: a minute
_MIN_SPEED, _MAX_SPEED = 0.1, 100.0


@dataclass(frozen=True)
class FilmOptions:
    """Options of `film`, `record` and the command `play`.

    Attributes:
        episodes: Number of episodes.
        steps: Control steps at most in an episode; None: `episode_steps` of the settings, else 300.
        seed: Of the first episode; each further episode adds 1.
        camera: "above" or "chase".
        speed: Playback speed; 1 is real time.
        simulation: A simulator, see `find_simulator`; "ros" or a `RosRobot`: a real robot, filmed by its odometry and
            its laser; None: `default_simulator`.
        on_end: Called with a line about each finished episode.
        progress: Whether to show a progress bar if there is a terminal.

    Raises:
        InputError: If a number is out of range, or the camera is unknown.
    """

    episodes: int = 1
    steps: int | None = None
    seed: int = 0
    camera: str = "above"
    speed: float = 1.0
    simulation: Any = None
    on_end: Callable[[str], None] | None = None
    progress: bool = False

    def __post_init__(self) -> None:
        if self.episodes < 1 or (self.steps is not None and self.steps < 1) or not 0 <= self.seed <= LARGEST_SEED:
            raise InputError(f"episodes and steps must be at least 1, and the seed from 0 to {LARGEST_SEED}")
        if not _MIN_SPEED <= self.speed <= _MAX_SPEED:
            raise InputError(f"the speed must be from {_MIN_SPEED} to {_MAX_SPEED}, got {self.speed:g}")
        if self.camera not in CAMERAS:
            raise unknown("camera", self.camera, CAMERAS)

    @property
    def simulator(self) -> SimulatorType:
        """The type of the simulator."""
        return default_simulator() if self.simulation is None else find_simulator(self.simulation)

    def progress_bar(self, title: str, scene: Scene) -> tqdm[None]:
        """A bar over the control steps of all episodes."""
        total = self.episodes * scene.task.episode_steps
        return progress_bar(None, title, "step", total=total, shown=self.progress)


DEFAULT_OPTIONS = FilmOptions()


def load_policy(
    policy: Policy | str | Path, config: Config | None, settings: Mapping[str, Any] | None, options: FilmOptions
) -> tuple[Policy, Scene]:
    """A policy and the scene that it drives in; arguments as in `film`.

    Raises:
        InputError: If there is no such policy, or it has other observations or actions than the scene.
    """
    settings = settings or {}
    steps = time_limit(options.steps, settings, STEPS)
    if isinstance(policy, str | Path):
        policy = load(policy)
    scene = (config or config_of(policy)).with_task({**settings, "episode_steps": steps}).scene.worlds_for("test")
    check_observes(policy, scene)
    return policy, scene


def roll_out_episodes(
    loop: ControlLoop, policy: Policy, options: FilmOptions, on_step: Callable[[], Any] = lambda: None
) -> Iterator[Iterator[Moment]]:
    """The control steps of one episode after the other; each episode must be consumed before the next."""
    for episode in range(options.episodes):
        yield _roll_out(loop, policy, options, episode, on_step)


def _roll_out(
    loop: ControlLoop, policy: Policy, options: FilmOptions, episode: int, on_step: Callable[[], Any]
) -> Iterator[Moment]:
    for moment in roll_out(loop, policy, options.seed + episode):
        ended, distance, time = moment.info["ended"], moment.info["distance"], moment.step * loop.task.control_period
        if ended and options.on_end:
            options.on_end(
                f"episode {episode + 1}: {ended} after {moment.step} steps ({time:.1f} s), "
                f"{distance:.1f} m, {distance / time:.3f} m/s, return {moment.total:g}"
            )
        yield moment
        on_step()
