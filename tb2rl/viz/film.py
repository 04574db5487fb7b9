"""Films (MP4 or GIF) and ROS bags of a policy's episodes."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image, ImageColor

from tb2rl.core import InputError, check_output, one_line, unknown
from tb2rl.core.files import atomic_write
from tb2rl.deploy.bags.recorder import open_bag
from tb2rl.deploy.bags.writing import checked_bag_path
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import LARGEST_SEED, EpisodeStep, Policy, check_spaces, roll_out
from tb2rl.evaluation.evaluate import time_limit
from tb2rl.evaluation.progress import progress
from tb2rl.rendering.above import add_header
from tb2rl.rendering.colours import FILM_PALETTE
from tb2rl.runs import Config, config_of, load
from tb2rl.simulation.simulator import SimulatorType, default_simulator, find_simulator
from tb2rl.viz.cameras import CAMERAS, FilmCamera, FilmFrame, add_caption, film_frames, world_of
from tb2rl.viz.pictures import extend_bounds

FILM_STEPS = 300  # default time limit of a filmed episode [control steps]
_GIF_COLOURS = 64


@dataclass(frozen=True)
class FilmOptions:
    """Options of `film`, `record` and the command `play`.

    Attributes:
        episodes: Number of episodes.
        steps: Time limit of an episode [control steps]; None: `episode_steps` in the settings that `film` gets as an
            argument, or else 300.
        seed: Seed of the first episode; each further episode adds 1.
        camera: "above" or "chase".
        speed: Playback speed; 1 is real time.
        simulation: An argument of `find_simulator`; None: `default_simulator`. "ros" or a `RosRobot` films a real robot
            by its odometry and its laser.
        on_episode_end: Function that is called with a line of text about each finished episode.
        progress_bar: Whether to show a progress bar if there is a terminal.
        name: Name of the policy in the title of a film; None: only its agent is named.

    Raises:
        InputError: If a number is out of range, or the camera is unknown.
    """

    episodes: int = 1
    steps: int | None = None
    seed: int = 0
    camera: str = "above"
    speed: float = 1.0
    simulation: Any = None
    on_episode_end: Callable[[str], None] | None = None
    progress_bar: bool = False
    name: str | None = None

    def __post_init__(self) -> None:
        if self.episodes < 1 or (self.steps is not None and self.steps < 1) or not 0 <= self.seed <= LARGEST_SEED:
            raise InputError(f"episodes and steps must be at least 1, and the seed from 0 to {LARGEST_SEED}")
        if not 0.1 <= self.speed <= 100.0:
            raise InputError(f"the speed must be from 0.1 to 100, got {self.speed:g}")
        if self.camera not in CAMERAS:
            raise unknown("camera", self.camera, CAMERAS)

    @property
    def simulator(self) -> SimulatorType:
        """The type of the selected simulator."""
        return default_simulator() if self.simulation is None else find_simulator(self.simulation)


DEFAULT_OPTIONS = FilmOptions()
AnyPolicy = Policy | str | Path  # a policy, or a reference for `load`


def film(
    policy: AnyPolicy,
    path: str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    options: FilmOptions = DEFAULT_OPTIONS,
) -> Path:
    """Film a policy at the task of its training or of another config.

    A notebook shows the film with `IPython.display.Video(path, embed=True)`.

    Args:
        policy: A loaded policy, a reference for `load`, or an object with `predict`.
        path: The file of the film, .mp4 or .gif; the complete film replaces an existing file.
        config: A config with the task; None: the config that the policy was trained with.
        settings: Task settings to change, for example {"world": "circuit"}.
        options: Episodes, camera, playback speed and simulator.

    Returns:
        The path of the film.

    Raises:
        InputError: If an argument is invalid, or the film cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"a film must end in {' or '.join(WRITERS)}, got {str(path)!r}")
    check_output(path)
    policy = load(policy) if isinstance(policy, str | Path) else policy
    config = config or config_of(policy)
    name = f"{options.name} ({config.agent_name})" if options.name else config.agent_name
    subject = f"{name}, task {config.task_name}, "
    with open_episodes(policy, config, settings, options, "filming") as (scene, episodes):
        if not options.simulator.is_external:
            write_film(path, episodes, scene, options, subject)
            return path
        recorded_episodes = [list(steps) for steps in episodes]  # drawn later, because a real robot does not wait
    points = np.array([step.after.pose[0, :2] for steps in recorded_episodes for step in steps])
    world = extend_bounds(scene.world, points)  # because the bounds of a real robot's surroundings are unknown
    write_film(path, recorded_episodes, scene.in_worlds((world,)), options, subject)
    return path


def record(
    policy: AnyPolicy,
    path: str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    options: FilmOptions = DEFAULT_OPTIONS,
) -> list[Path]:
    """Record a ROS bag of each simulated episode; `tb2rl.deploy.bags.recorder` lists the topics.

    Args:
        path: A .bag file for ROS 1, or a folder for ROS 2; for several episodes, numbers are added to the name.
        policy, config, settings, options: As for `film`; `camera` and `speed` have no effect.

    Returns:
        The paths of the bags.

    Raises:
        InputError: If an argument is invalid, a bag cannot be written, or `rosbags` is not installed.
    """
    if options.simulator.is_external:
        raise InputError(f"record works in simulation only, got {options.simulation!r}; use rosbag for a real robot")
    path = Path(path)
    labels = [""] if options.episodes == 1 else [f"-{index + 1}" for index in range(options.episodes)]
    bags = [checked_bag_path(path.with_name(f"{path.stem}{label}{path.suffix}")) for label in labels]
    with open_episodes(policy, config, settings, options, "recording") as (scene, episodes):
        for bag, steps in zip(bags, episodes, strict=True):
            with open_bag(bag, scene) as recorder:
                for step in steps:
                    if step.number == 1:
                        recorder.reset(step.before)
                    assert step.command is not None, "steps of a control loop have commands"
                    recorder.step(step.command, step.reward, step.after)
    return bags


@contextmanager
def open_episodes(
    policy: AnyPolicy, config: Config | None, settings: Mapping[str, Any] | None, options: FilmOptions, title: str
) -> Iterator[tuple[Scene, Iterator[Iterator[EpisodeStep]]]]:
    """Yield the scene and the episodes, each as an iterator of control steps.

    All episodes use one control loop, so each must be consumed before the next one.

    Args:
        policy, config, settings, options: As for `film`.
        title: Title of the progress bar.

    Raises:
        InputError: If the policy does not exist, or has other spaces than the task.
    """
    settings = settings or {}
    steps = time_limit(options.steps, settings, FILM_STEPS)
    policy = load(policy) if isinstance(policy, str | Path) else policy
    scene = (config or config_of(policy)).with_task({**settings, "episode_steps": steps}).scene.for_purpose("test")
    check_spaces(policy, scene)
    loop, max_steps = ControlLoop.open(scene, options.simulator), options.episodes * scene.task.episode_steps
    with closing(loop), progress(None, title, "step", total=max_steps, shown=options.progress_bar) as bar:
        yield loop.scene, (_steps_of(loop, policy, options, index, bar) for index in range(options.episodes))


def _steps_of(loop: ControlLoop, policy: Policy, options: FilmOptions, index: int, bar: Any) -> Iterator[EpisodeStep]:
    for step in roll_out(loop, policy, options.seed + index):
        if (ended := step.info["ended"]) and options.on_episode_end:
            distance, time = step.info["distance"], step.number * loop.task.control_period
            details = f"{distance:.1f} m, {distance / time:.3f} m/s, return {step.episode_return:g}"
            options.on_episode_end(f"episode {index + 1}: {ended} after {step.number} steps ({time:.1f} s), {details}")
        yield step
        bar.update()


def write_film(
    path: Path, episodes: Iterable[Iterable[EpisodeStep]], scene: Scene, options: FilmOptions, subject: str
) -> None:
    """Write a film of several episodes; their title is `subject`, the world and the robot.

    Raises:
        InputError: If the file cannot be written.
    """
    write, max_rate = WRITERS[path.suffix.lower()]
    with closing(CAMERAS[options.camera](scene)) as view:
        rate, period = min(max_rate, view.max_rate), scene.task.control_period
        frames = (frame for steps in episodes for frame in film_frames(steps, period, rate, options.speed))
        pictures = (_film_picture(view, frame, scene, subject, options.speed) for frame in frames)
        try:
            with atomic_write(path) as temporary:
                write(temporary, pictures, rate)
        except BrokenPipeError:  # from `on_episode_end`, which may print to a closed stdout
            raise
        except (OSError, av.error.FFmpegError) as error:
            raise InputError(one_line(f"cannot write {path}: {error.strerror or error}")) from None


def _film_picture(view: FilmCamera, frame: FilmFrame, scene: Scene, subject: str, speed: float) -> np.ndarray:
    title = f"{subject}world {world_of(frame, scene).name}, {scene.robot.name}"
    title += "" if speed == 1.0 else f", speed x{speed:.3g}"
    return add_header(add_caption(view.picture(frame), frame, scene), title, view.legend(frame, scene))


def write_mp4(path: Path, pictures: Iterator[np.ndarray], rate: int) -> None:
    """Write an MP4 file in H.264, which browsers and notebooks can play.

    Args:
        path: The file.
        pictures: RGB pictures, shape (height, width, 3), uint8; height and width are even.
        rate: Pictures per second.
    """
    with av.open(str(path.absolute()), "w", format="mp4", options={"movflags": "faststart"}) as container:
        # The pictures change little, so a short motion search saves 1/6 of the CPU time, and files are only 8 % larger.
        options = {"preset": "veryfast", "crf": "22", "x264-params": "subme=1:me=dia"}
        stream = container.add_stream("libx264", rate=rate, options=options)
        stream.pix_fmt = "yuv420p"
        stream.thread_count = 1  # because drawing takes longer than encoding
        for index, picture in enumerate(pictures):
            if index == 0:
                stream.height, stream.width, _ = picture.shape
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def write_gif(path: Path, pictures: Iterator[np.ndarray], rate: int) -> None:
    """Write a looping GIF file; arguments as for `write_mp4`.

    The pictures share a palette, so that static regions take no space.
    """
    first = next(pictures)
    # Add an area of each colour to the first picture, so that the palette contains colours that appear later.
    swatches = [np.full((len(first), 8, 3), ImageColor.getrgb(colour), dtype=np.uint8) for colour in FILM_PALETTE]
    palette = Image.fromarray(np.hstack([first, *swatches])).quantize(_GIF_COLOURS)
    no_dither: Any = Image.Dither.NONE
    images = (Image.fromarray(p).quantize(palette=palette, dither=no_dither) for p in chain([first], pictures))
    animation: dict[str, Any] = {"duration": 1000 // rate, "loop": 0, "optimize": True}
    next(images).save(path, format="GIF", save_all=True, append_images=images, **animation)


WRITERS = {".mp4": (write_mp4, 30), ".gif": (write_gif, 10)}  # function and maximum rate [pictures/s] by suffix
