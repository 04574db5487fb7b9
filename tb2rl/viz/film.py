"""Films of a policy that drives, as MP4 or GIF files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import av
import numpy as np

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.files import replacing
from tb2rl.deploy.ros.robot import RosRobot, ros_robot
from tb2rl.envs.scene import Scene
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.evaluation.moments import LARGEST_SEED, Moment, Policy, roll_out, time_limit
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.spaces import check_observes
from tb2rl.runs.config import Config
from tb2rl.runs.loading import config_of, load
from tb2rl.simulation import SIMULATIONS, default_simulator
from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.caption import with_caption
from tb2rl.viz.shots import shots
from tb2rl.viz.writers import WRITERS

STEPS = 300  # control steps: a minute
_AROUND = 1.0  # [m] of the floor around a robot's way
_SLOWEST, _FASTEST = 0.1, 100.0

Listener = Callable[[int, Moment], None]  # is told the number of an episode, from 1, and its last step


def open_scene(
    policy: Policy | str | Path, config: Config | None, settings: Mapping[str, Any], steps: int
) -> tuple[Policy, Scene]:
    """A policy, loaded if it is a reference, and what its environment is made of; arguments as in `film`.

    Raises:
        InputError: If there is no such policy, or it knows other observations or actions.
    """
    if isinstance(policy, str | Path):
        policy = load(policy)
    scene = (config or config_of(policy)).with_task({**settings, "episode_steps": steps}).scene.worlds_for("test")
    check_observes(policy, scene)
    return policy, scene


def open_env(
    policy: Policy | str | Path,
    config: Config | None,
    settings: Mapping[str, Any],
    steps: int,
    simulation: str | None = None,
) -> tuple[Policy, TurtleBot2Env]:
    """The same with the environment, see `open_scene`; `simulation` None: see `default_simulator`."""
    policy, scene = open_scene(policy, config, settings, steps)
    return policy, TurtleBot2Env(scene, simulation=simulation or default_simulator())


def drives(
    env: TurtleBot2Env, policy: Policy, episodes: int, seed: int, listener: Listener | None = None
) -> Iterator[Iterator[Moment]]:
    """Episodes one after the other, each from a seed of its own; `listener` hears of the end of each."""
    for episode in range(episodes):
        moments = roll_out(env, policy, seed + episode)
        yield _heard(moments, episode + 1, listener) if listener else moments


def _heard(moments: Iterable[Moment], episode: int, listener: Listener) -> Iterator[Moment]:
    for moment in moments:
        if moment.info["ended"]:
            listener(episode, moment)
        yield moment


def film(
    policy: Policy | str | Path,
    path: str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    episodes: int = 1,
    steps: int | None = None,
    seed: int = 0,
    camera: str = "above",
    speed: float = 1.0,
    listener: Listener | None = None,
    progress: bool = False,
    simulation: RosRobot | str | None = None,
) -> Path:
    """Film a policy at what it was trained to do. In a notebook: `IPython.display.Video(path, embed=True)`.

    Args:
        policy: A loaded policy, a reference that `load` takes, or anything with `predict`.
        path: The film, .mp4 or .gif; an older one is replaced once the new one is complete.
        config: What it is to do; None: what it was trained to do.
        settings: Changes to the task by name, for example {"world": "circuit"}.
        episodes: How many, one after the other.
        steps: Control steps at most in an episode; None: `episode_steps` of the settings, else 300.
        seed: Of the first episode; the next ones count on.
        camera: "above" or "chase".
        speed: How many times as fast as it happened.
        listener: Is called with the number of each episode, from 1, and its last step.
        progress: Whether to draw a bar, where there is a terminal.
        simulation: "bullet" or "kinematic"; "ros" or a `RosRobot`: a robot that drives instead, and is filmed by its
            odometry and its laser; None: PyBullet's physics, or where PyBullet is missing or broken its fast twin.

    Returns:
        The path.

    Raises:
        InputError: If anything of this does not fit, or the film cannot be written.
    """
    path, steps = check_film(path, camera), time_limit(steps, settings or {}, STEPS)
    check_numbers(episodes, steps, seed, speed)
    policy, scene = open_scene(policy, config, settings or {}, steps)
    if simulation is None:
        simulation = default_simulator()
    if isinstance(simulation, str) and simulation in SIMULATIONS:
        env = TurtleBot2Env(scene, simulation=simulation)
    else:
        env = ros_robot(simulation).env(scene)
    bar = progress_bar(None, "filming", "step", total=episodes * steps, shown=progress)
    with closing(env), bar:
        driven = (_counted(moments, bar.update) for moments in drives(env, policy, episodes, seed, listener))
        if simulation in SIMULATIONS:
            write_film(path, driven, env.scene, camera, speed)
            return path
        whole = [list(moments) for moments in driven]  # a robot does not wait for pictures
    write_film(path, whole, _scene_of(whole, env.scene), camera, speed)
    return path


def _scene_of(driven: Sequence[Sequence[Moment]], scene: Scene) -> Scene:
    """The scene with bounds that hold what was driven: of a robot nobody knows where it will go."""
    places = np.array([moment.pose[:2] for moments in driven for moment in moments])
    x0, y0, x1, y1 = scene.world.bounds
    low, high = np.minimum((x0, y0), places.min(axis=0) - _AROUND), np.maximum((x1, y1), places.max(axis=0) + _AROUND)
    bounds = (*low.tolist(), *high.tolist())
    return scene.in_worlds((scene.world.with_places(None, None, bounds),))


def write_film(
    path: Path, driven: Iterable[Iterable[Moment]], scene: Scene, camera: str = "above", speed: float = 1.0
) -> None:
    """Write the film of episodes that are driven one after the other; arguments as in `film`.

    Raises:
        InputError: If it cannot be written.
    """
    write, fastest = WRITERS[path.suffix.lower()]
    with closing(CAMERAS[camera](scene)) as view:
        rate = min(fastest, view.rate)
        shown = (shot for moments in driven for shot in shots(moments, scene.task.control_period, rate, speed))
        frames: Iterator[np.ndarray] = (with_caption(view.picture(shot), shot, scene) for shot in shown)
        try:
            with replacing(path) as temporary:
                write(temporary, frames, rate)
        except BrokenPipeError:  # not of the film: whoever reads what is printed went away
            raise
        except (OSError, av.error.FFmpegError) as error:
            raise InputError(one_line(f"cannot write {path}: {error.strerror or error}")) from None


def _counted(moments: Iterable[Moment], count: Callable[[], Any]) -> Iterator[Moment]:
    for moment in moments:
        yield moment
        count()


def check_film(path: str | Path, camera: str) -> Path:
    """The path of a film that can be written.

    Raises:
        InputError: If it cannot, or there is no such camera.
    """
    path = Path(path)
    if camera not in CAMERAS:
        raise unknown("camera", camera, CAMERAS)
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"a film is {' or '.join(WRITERS)}, got {str(path)!r}")
    folder = path.absolute().parent
    if path.is_dir() or not folder.is_dir():
        raise InputError(f"cannot write {path}: it is a folder, or its folder does not exist")
    if not os.access(folder, os.W_OK):
        raise InputError(f"cannot write {path}: the folder {folder} is not writable")
    return path


def check_numbers(episodes: int, steps: int, seed: int, speed: float = 1.0) -> None:
    """Raise an `InputError` where a number is out of its range."""
    if min(episodes, steps) < 1 or not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"episodes and steps must be at least 1, and the seed from 0 to {LARGEST_SEED}")
    if not _SLOWEST <= speed <= _FASTEST:
        raise InputError(f"the speed must be from {_SLOWEST} to {_FASTEST}, got {speed:g}")
