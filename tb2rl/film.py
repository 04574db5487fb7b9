"""Films of a policy that drives: a picture at any instant of an episode, and MP4 or GIF files of them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Protocol

import av
import numpy as np
from PIL import Image

from tb2rl.actions import action_names
from tb2rl.checkpoint import replacing
from tb2rl.config import Config
from tb2rl.driving import LARGEST_SEED, Moment, Policy, drive
from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError, one_line, unknown
from tb2rl.evaluation import check_observes, with_task
from tb2rl.laser import cast
from tb2rl.maze import Maze
from tb2rl.render import Scene, draw_caption, with_caption, with_colours
from tb2rl.robot import Laser
from tb2rl.runs import config_of, load
from tb2rl.simulation.bullet import Stage
from tb2rl.tasks import Task

STEPS = 300  # control steps: a minute
_SLOWEST, _FASTEST = 0.1, 100.0
_STRIP_WIDTH = 560  # [px] that a caption needs at least
_CHASE_SIZE = (640, 360)  # [px]
_GIF_COLOURS = 64
_HOLD = 1.0  # [s] that the end of an episode stays to be seen


def open_world(
    policy: Policy | str | Path, config: Config | None, settings: Mapping[str, Any], steps: int
) -> tuple[Policy, TurtleBot2Env]:
    """A policy, loaded if it is a reference, and the environment that it plays in.

    Raises:
        InputError: If there is no such policy, or it knows other observations or actions.
    """
    if isinstance(policy, str | Path):
        policy = load(policy)
    config = with_task(config or config_of(policy), {**settings, "episode_steps": steps})
    check_observes(policy, config)
    return policy, TurtleBot2Env(config.task_settings, config.observation)


@dataclass(frozen=True)
class Shot:
    """An instant of a drive, to be shown."""

    moment: Moment  # the control step that it belongs to
    path: Sequence[np.ndarray]  # poses (3,) since the reset, up to the one that the step began at
    pose: np.ndarray  # shape (3,)
    time: float  # since the reset [s]
    over: bool  # whether the episode is


def shots(moments: Iterable[Moment], period: float, rate: float, speed: float = 1.0) -> Iterator[Shot]:
    """Show an episode `speed` times as fast as it happened, `rate` times a second; its end stays for a while.

    Between control steps, `period` [s] apart, the robot moves on a straight line.
    """
    count = 0
    path: tuple[np.ndarray, ...] = ()
    for moment in moments:
        path = (*path, moment.before)
        end = moment.step * period
        while (instant := count * speed / rate) < end - 1e-9:
            share = instant / period - (moment.step - 1)
            yield Shot(moment, path, between(moment.before, moment.pose, share), instant, over=False)
            count += 1
        if moment.info["ended"]:
            yield from [Shot(moment, path, moment.pose, end, over=True)] * round(_HOLD * rate)


def between(before: np.ndarray, after: np.ndarray, share: float) -> np.ndarray:
    """The pose a `share` of the way between two."""
    way = after - before
    way[2] = math.remainder(way[2], math.tau)
    return before + share * way


def speeds(before: np.ndarray, after: np.ndarray, period: float) -> tuple[float, float]:
    """Mean forward speed v [m/s] and turn rate w [rad/s] between two poses (3,)."""
    east, north, turn = after - before
    turn = math.remainder(turn, math.tau)
    heading = before[2] + turn / 2
    return (east * math.cos(heading) + north * math.sin(heading)) / period, turn / period


def drive_all(
    env: TurtleBot2Env, policy: Policy, episodes: int, seed: int, tell: bool = True
) -> Iterator[Iterator[Moment]]:
    """Episodes one after the other, each from a seed of its own; `tell` prints a line as each of them ends."""
    for episode in range(episodes):
        moments = drive(env, policy, seed + episode)
        yield _told(moments, episode + 1, env.task.control_period) if tell else moments


def _told(moments: Iterable[Moment], episode: int, period: float) -> Iterator[Moment]:
    for moment in moments:
        ended, distance = moment.info["ended"], moment.info["distance"]
        if ended:
            seconds = moment.step * period
            print(
                f"episode {episode}: {ended} after {moment.step} steps ({seconds:.1f} s), "
                f"{distance:.1f} m, {distance / seconds:.3f} m/s, return {moment.total:g}",
                flush=True,
            )
        yield moment


def goal_of(task: Task) -> tuple[float, float] | None:
    """Where a task's goal is, x and y [m], if it has one."""
    return getattr(task, "goal", None)


class Camera(Protocol):
    """What films a drive."""

    rate: int  # pictures a second

    def picture(self, shot: Shot) -> np.ndarray:
        """The world at an instant, shape (height, width, 3), uint8, with even sides."""

    def close(self) -> None:
        """Free what the camera holds."""


class AboveCamera:
    """The maze from above, with the robot's beams and its path."""

    rate = 15

    def __init__(self, maze: Maze, task: Task, laser: Laser) -> None:
        self._maze, self._scene = maze, Scene(maze, task, laser)
        self._beams = np.cos(laser.angles), np.sin(laser.angles)
        self._ranges = np.empty((1, len(laser.angles)))

    def picture(self, shot: Shot) -> np.ndarray:
        cast(shot.pose[None], *self._beams, self._maze.boxes, self._maze.posts, self._ranges)
        return self._scene.draw(shot.pose, self._ranges[0], [*shot.path, shot.pose])

    def close(self) -> None:
        pass


class ChaseCamera:
    """The robot in 3D, from behind and above."""

    rate = 10  # a picture takes several times as long as one from above

    def __init__(self, maze: Maze, task: Task, laser: Laser) -> None:
        self._stage = Stage(maze, goal_of(task))

    def picture(self, shot: Shot) -> np.ndarray:
        self._stage.place(shot.pose)
        return self._stage.chase(*_CHASE_SIZE)

    def close(self) -> None:
        self._stage.close()


CAMERAS: dict[str, type[AboveCamera] | type[ChaseCamera]] = {"above": AboveCamera, "chase": ChaseCamera}


def film(
    policy: Policy | str | Path,
    path: str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    episodes: int = 1,
    steps: int = STEPS,
    seed: int = 0,
    camera: str = "above",
    speed: float = 1.0,
    tell: bool = False,
) -> Path:
    """Film a policy at what it was trained to do. In a notebook: `IPython.display.Video(path, embed=True)`.

    Args:
        policy: A loaded policy, a reference that `load` takes, or anything with `predict`.
        path: The film, .mp4 or .gif; an older one is replaced once the new one is complete.
        config: What it is to do; None: what it was trained to do.
        settings: Changes to the task by name, for example {"maze": "circuit"}.
        episodes: How many, one after the other.
        steps: Control steps at most in an episode.
        seed: Of the first episode; the next ones count on.
        camera: "above" or "chase".
        speed: How many times as fast as it happened.
        tell: Print a line for each episode.

    Returns:
        The path.

    Raises:
        InputError: If anything of this does not fit, or the film cannot be written.
    """
    path = check_film(path, camera)
    check_numbers(episodes, steps, seed, speed)
    policy, env = open_world(policy, config, settings or {}, steps)
    with closing(env), closing(CAMERAS[camera](env.maze, env.task, env.laser)) as eye:
        write, rate = WRITERS[path.suffix.lower()]
        rate = min(rate, eye.rate)
        drives = drive_all(env, policy, episodes, seed, tell)
        frames = (
            _frame(shot, eye, env.task)
            for moments in drives
            for shot in shots(moments, env.task.control_period, rate, speed)
        )
        try:
            with replacing(path) as temporary:
                write(temporary, frames, rate)
        except BrokenPipeError:  # not of the film: whoever reads what is printed went away
            raise
        except (OSError, av.error.FFmpegError) as error:
            raise InputError(one_line(f"cannot write {path}: {error.strerror or error}")) from None
    return path


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
        raise InputError(f"cannot write {path}: it is a folder, or there is none for it")
    if not os.access(folder, os.W_OK):
        raise InputError(f"cannot write {path}: the folder {folder} is not writable")
    return path


def check_numbers(episodes: int, steps: int, seed: int, speed: float) -> None:
    """Raise an `InputError` where a number is out of its range."""
    if min(episodes, steps) < 1 or not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"episodes and steps must be at least 1, and the seed from 0 to {LARGEST_SEED}")
    if not _SLOWEST <= speed <= _FASTEST:
        raise InputError(f"the speed must be from {_SLOWEST} to {_FASTEST}, got {speed:g}")


def _frame(shot: Shot, camera: Camera, task: Task) -> np.ndarray:
    picture = camera.picture(shot)
    width = max(_STRIP_WIDTH, picture.shape[1])
    loud = "ended" if shot.moment.info["ended"] == "crash" else None
    return with_caption(picture, draw_caption(width, caption(shot, task), loud))


def caption(shot: Shot, task: Task) -> dict[str, str]:
    """What a film says of an instant."""
    moment = shot.moment
    v, w = speeds(moment.before, moment.pose, task.control_period)
    return {
        "time [s]": f"{shot.time:.1f}",
        "v [m/s]": f"{v:z.2f}",
        "w [rad/s]": f"{w:+z.2f}",
        **({"ended": moment.info["ended"]} if shot.over else {"action": action_names(task.commands)[moment.action]}),
        "reward": f"{moment.reward:+g}",
        "return": f"{moment.total:g}",
    }


def write_mp4(path: Path, frames: Iterator[np.ndarray], rate: int) -> None:
    """Write pictures of one size, with even sides, as H.264: what browsers and notebooks play."""
    with av.open(str(path.absolute()), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=rate, options={"preset": "veryfast", "crf": "22"})
        stream.pix_fmt = "yuv420p"
        stream.thread_count, stream.thread_type = 2, "FRAME"  # encodes while the next picture is drawn
        for number, frame in enumerate(frames):
            if number == 0:
                stream.height, stream.width, _ = frame.shape
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def write_gif(path: Path, frames: Iterator[np.ndarray], rate: int) -> None:
    """Write pictures of one size as a GIF that repeats; all share one palette, so that what stays costs nothing."""
    first = next(frames)
    colours = Image.fromarray(with_colours(first)).quantize(_GIF_COLOURS)
    pictures = (
        Image.fromarray(frame).quantize(palette=colours, dither=Image.Dither.NONE) for frame in chain([first], frames)
    )
    next(pictures).save(
        path, format="GIF", save_all=True, append_images=pictures, duration=1000 // rate, loop=0, optimize=True
    )


WRITERS: dict[
    str, tuple[Callable[[Path, Iterator[np.ndarray], int], None], int]
] = {  # and their most pictures a second
    ".mp4": (write_mp4, 30),
    ".gif": (write_gif, 10),
}
