"""Films of a driving policy, as MP4 or GIF files, and bags of ROS."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import chain
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image, ImageColor

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import replacing
from tb2rl.deploy.bags.recorder import check_bag, open_bag
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.moments import Moment
from tb2rl.rendering.colours import FILM_PALETTE
from tb2rl.runs.config import Config
from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.caption import add_caption
from tb2rl.viz.episodes import DEFAULT_OPTIONS, FilmOptions, load_policy, roll_out_episodes
from tb2rl.viz.film_frames import film_frames

_MARGIN = 1.0  # [m] around the path of a real robot
_GIF_COLOURS = 64

# Takes the file, pictures with even sides, shape (height, width, 3), uint8, and their number a second.
Writer = Callable[[Path, Iterator[np.ndarray], int], None]


def film(
    policy: Policy | str | Path,
    path: str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    options: FilmOptions = DEFAULT_OPTIONS,
) -> Path:
    """Film a policy at the task that it was trained for. In a notebook: `IPython.display.Video(path, embed=True)`.

    Args:
        policy: A loaded policy, a reference that `load` takes, or any object with `predict`.
        path: The film, .mp4 or .gif; an older one is replaced once the new one is complete.
        config: Another task; None: the one of the training.
        settings: Changes to the task by name, for example {"world": "circuit"}.
        options: Episodes, camera, playback speed and simulator.

    Returns:
        The path.

    Raises:
        InputError: If an argument does not fit, or the film cannot be written.
    """
    path = check_film(path)
    policy, scene = load_policy(policy, config, settings, options)
    loop = ControlLoop.open(scene, options.simulator)
    with closing(loop), options.progress_bar("filming", scene) as bar:
        episodes = roll_out_episodes(loop, policy, options, bar.update)
        if not options.simulator.is_robot:
            write_film(path, episodes, loop.scene, options.camera, options.speed)
            return path
        complete = [list(moments) for moments in episodes]  # because a robot does not wait for the pictures
    write_film(path, complete, _extend_bounds(loop.scene, complete), options.camera, options.speed)
    return path


def _extend_bounds(scene: Scene, episodes: Sequence[Sequence[Moment]]) -> Scene:
    """The scene with bounds around the path of a robot, whose surroundings are unknown before it drives."""
    points = np.array([moment.after.pose[0, :2] for moments in episodes for moment in moments])
    x0, y0, x1, y1 = scene.world.bounds
    low, high = np.minimum((x0, y0), points.min(axis=0) - _MARGIN), np.maximum((x1, y1), points.max(axis=0) + _MARGIN)
    bounds = (*low.tolist(), *high.tolist())
    return scene.in_worlds((scene.world.with_places(None, None, bounds),))


def write_film(
    path: Path, episodes: Iterable[Iterable[Moment]], scene: Scene, camera: str = "above", speed: float = 1.0
) -> None:
    """Write the film of consecutive episodes.

    Raises:
        InputError: If it cannot be written.
    """
    write, max_rate = WRITERS[path.suffix.lower()]
    with closing(CAMERAS[camera](scene)) as view:
        rate, period = min(max_rate, view.rate), scene.task.control_period
        frames = (frame for moments in episodes for frame in film_frames(moments, period, rate, speed))
        pictures = (add_caption(view.picture(frame), frame, scene) for frame in frames)
        try:
            with replacing(path) as temporary:
                write(temporary, pictures, rate)
        except BrokenPipeError:  # from stdout, not from the film
            raise
        except (OSError, av.error.FFmpegError) as error:
            raise InputError(one_line(f"cannot write {path}: {error.strerror or error}")) from None


def write_mp4(path: Path, pictures: Iterator[np.ndarray], rate: int) -> None:
    """Write an MP4 file with H.264, which browsers and notebooks play."""
    with av.open(str(path.absolute()), "w", format="mp4", options={"movflags": "faststart"}) as container:
        # Drawings move little, so a short motion search is enough: 8 % larger files, a sixth less work.
        options = {"preset": "veryfast", "crf": "22", "x264-params": "subme=1:me=dia"}
        stream = container.add_stream("libx264", rate=rate, options=options)
        stream.pix_fmt = "yuv420p"
        stream.thread_count = 1  # a second thread costs a quarter more work and gains little beside the drawing
        for number, picture in enumerate(pictures):
            if number == 0:
                stream.height, stream.width, _ = picture.shape
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def write_gif(path: Path, pictures: Iterator[np.ndarray], rate: int) -> None:
    """Write a GIF file that repeats; all pictures share one palette, so that static regions take no space."""
    first = next(pictures)
    samples = [np.full((len(first), 8, 3), ImageColor.getrgb(colour), dtype=np.uint8) for colour in FILM_PALETTE]
    palette = Image.fromarray(np.hstack([first, *samples])).quantize(_GIF_COLOURS)
    images = (
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in chain([first], pictures)
    )
    options = {"save_all": True, "append_images": images, "duration": 1000 // rate, "loop": 0, "optimize": True}
    next(images).save(path, format="GIF", **options)


WRITERS: dict[str, tuple[Writer, int]] = {".mp4": (write_mp4, 30), ".gif": (write_gif, 10)}  # with the highest rate


def check_film(path: str | Path) -> Path:
    """The path of a film that can be written.

    Raises:
        InputError: If it cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"a film is {' or '.join(WRITERS)}, got {str(path)!r}")
    folder = path.absolute().parent
    if path.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(f"cannot write {path}: name a file in a writable folder")
    return path


def record(
    policy: Policy | str | Path,
    path: str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    options: FilmOptions = DEFAULT_OPTIONS,
) -> list[Path]:
    """Record a policy at the task that it was trained for; `tb2rl.deploy.bags.recorder` lists the topics.

    Args:
        path: A file .bag for ROS 1, or a folder for ROS 2; the bags of several episodes are numbered.
        policy, config, settings, options: As in `film`; `camera` and `speed` have no effect.

    Returns:
        The bags.

    Raises:
        InputError: If an argument does not fit, a bag cannot be written, or `rosbags` is not installed.
    """
    if options.simulator.is_robot:
        raise InputError(f"bags are recorded in simulators, got {options.simulation!r}; use rosbag for a real robot")
    path = Path(path)
    names = [path.name]
    if options.episodes > 1:
        names = [f"{path.stem}-{number + 1}{path.suffix}" for number in range(options.episodes)]
    bags = [check_bag(path.with_name(name)) for name in names]
    policy, scene = load_policy(policy, config, settings, options)
    loop = ControlLoop.open(scene, options.simulator)
    with closing(loop), options.progress_bar("recording", scene) as bar:
        for bag, moments in zip(bags, roll_out_episodes(loop, policy, options, bar.update), strict=True):
            with open_bag(bag, scene) as recorder:
                for moment in moments:
                    if moment.step == 1:
                        recorder.reset(moment.before)
                    command = scene.actions.commands(scene.actions.checked(moment.action))[0]
                    recorder.step(command, moment.reward, moment.after)
    return bags
