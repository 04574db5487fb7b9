"""Frames of a film, interpolated between control steps, and cameras that draw them."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image, ImageDraw

from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import EpisodeStep
from tb2rl.rendering.above import Mark, WorldPicture, fitted_font, scale_bar
from tb2rl.rendering.colours import BEAM, BODY, DYNAMIC_OBSTACLE, FAILED, FLOOR, GOAL, LABEL, PATH, STRIP, WALL
from tb2rl.simulation import InitialState
from tb2rl.simulation.bullet import SIMULATOR
from tb2rl.simulation.obstacles.outlines import X, Y, cast_at_outlines
from tb2rl.tasks import Task
from tb2rl.worlds import World
from tb2rl.worlds.geometry import cast_many

_LAST_FRAME_DURATION = 1.0  # [s] in the film, at any playback speed
_CHASE_SIZE = (640, 360)  # [px] width and height of a chase picture
_TILE_COLOUR = "#d2cfc8"  # of the floor's dark tiles in a chase picture
CAPTION_HEIGHT = 48  # [px]
_MIN_CAPTION_WIDTH = 560  # [px]
_LABEL_SIZE, _VALUE_SIZE = 13, 19  # [px] font sizes of a caption


@dataclass(frozen=True)
class FilmFrame:
    """One instant of an episode."""

    step: EpisodeStep  # the control step that contains the instant
    time: float  # [s] time since the reset
    pose: np.ndarray  # x [m], y [m], yaw [rad], shape (3,)
    path: Sequence[np.ndarray]  # poses (3,) at the start of this and all earlier control steps
    ended: str | None  # name of the ending in the last frame of an episode, else None
    dynamic_obstacles: np.ndarray | None  # outlines as in `RobotState.dynamic_obstacles`, shape (obstacles, 6)


def film_frames(steps: Iterable[EpisodeStep], period: float, rate: float, speed: float = 1.0) -> Iterator[FilmFrame]:
    """The frames of an episode; the last frame is repeated for a second.

    Args:
        steps: The control steps of the episode.
        period: Duration of a control step [s].
        rate: Frames per second.
        speed: Playback speed; 1 is real time.
    """
    index = 0  # index of the next frame
    path: tuple[np.ndarray, ...] = ()
    for step in steps:
        path, ended, end_time = (*path, step.before.pose[0]), step.info["ended"], step.number * period
        while (time := index * speed / rate) < end_time - 1e-9:
            yield replace(interpolate_frame(step, path, period, time), ended=None)
            index += 1
        if ended:
            yield from [interpolate_frame(step, path, period, end_time)] * round(_LAST_FRAME_DURATION * rate)


def interpolate_frame(step: EpisodeStep, path: Sequence[np.ndarray], period: float, time: float) -> FilmFrame:
    """The frame of a control step at a time [s] since the reset; `path` and `period` as in `film_frames`."""
    fraction = min(max(time / period - (step.number - 1), 0.0), 1.0)
    pose = interpolate_pose(step.before.pose[0], step.after.pose[0], fraction)
    return FilmFrame(step, time, pose, path, step.info["ended"], _interpolate_outlines(step, fraction))


def interpolate_pose(before: np.ndarray, after: np.ndarray, fraction: float) -> np.ndarray:
    """Linear interpolation between two poses (3,); the yaw turns the shorter way."""
    difference = after - before
    difference[2] = math.remainder(difference[2], math.tau)
    return before + fraction * difference


def _interpolate_outlines(step: EpisodeStep, fraction: float) -> np.ndarray | None:
    """Outlines of dynamic obstacles (obstacles, 6) with interpolated positions and the orientations after the step."""
    before, after = step.before.dynamic_obstacles, step.after.dynamic_obstacles
    if before is None or after is None:
        return None
    outlines = after[0].copy()
    outlines[:, [X, Y]] = (1 - fraction) * before[0][:, [X, Y]] + fraction * after[0][:, [X, Y]]
    return outlines


def goal_of(task: Task, initial_state: InitialState) -> np.ndarray:
    """Goal x, y [m] of the first environment, shape (2,); NaN for a task without a goal."""
    return initial_state.goal[0] if task.goal_task else np.full(2, np.nan)


class AboveCamera:
    """Draws the world from above, with the robot, its laser beams and its path."""

    max_rate = 25  # pictures per second

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._initial_state: InitialState | None = None

    def picture(self, frame: FilmFrame) -> np.ndarray:
        """The picture of a frame, shape (height, width, 3), uint8; height and width are even."""
        scene, initial_state = self._scene, frame.step.after.initial_state
        if initial_state is not self._initial_state:  # a new episode
            self._initial_state, self._world = initial_state, scene.spec.worlds[int(initial_state.world[0])]
            self._picture = WorldPicture(self._world, scene.robot, scene.laser, goal_of(scene.task, initial_state))
        ranges = beam_ranges(frame, self._world, scene)
        return self._picture.draw(frame.pose, ranges, [*frame.path, frame.pose], frame.dynamic_obstacles)

    def legend(self, frame: FilmFrame, scene: Scene) -> list[Mark]:
        """What the lines and colours mean, and a scale."""
        lines = [Mark("path", PATH), Mark("laser", BEAM)]
        return [*lines, *_marks(frame, scene, "ring"), scale_bar(world_of(frame, scene))]

    def close(self) -> None:
        pass


def beam_ranges(frame: FilmFrame, world: World, scene: Scene) -> np.ndarray:
    """Exact ranges [m], shape (beams,), or the measured ones if no obstacles are known, as for a real robot."""
    if frame.dynamic_obstacles is None and len(world.boxes) + len(world.posts) == 0:
        return frame.step.after.ranges[0]
    outlines = np.empty((0, 6)) if frame.dynamic_obstacles is None else frame.dynamic_obstacles
    return exact_ranges(frame.pose[None], scene.laser.angles, world, outlines[None])[0]


def exact_ranges(poses: np.ndarray, angles: np.ndarray, world: World, outlines: np.ndarray) -> np.ndarray:
    """Ranges without noise [m], shape (n, beams), to walls and outlines (n, obstacles, 6) from poses (n, 3)."""
    directions = np.cos(angles), np.sin(angles)
    ranges = np.empty((len(poses), len(angles)))  # written by the functions below
    world_ids = np.zeros(len(poses))  # the spatial index of a world has only this world
    cast_many(poses, world_ids, directions, world.spatial_index, ranges)
    if outlines.size:
        cast_at_outlines(poses, directions, np.ascontiguousarray(outlines), ranges)
    return ranges


class ChaseCamera:
    """Renders the robot from behind and above."""

    max_rate = 10  # pictures per second; lower, because a picture takes several times as long as one from above

    def __init__(self, scene: Scene) -> None:
        SIMULATOR.check(purpose="camera 'chase' (unlike 'above')")
        from tb2rl.viz.scene_view import SceneView  # imports PyBullet, which may be missing

        self._task, self._view = scene.task, SceneView(scene.spec)

    def picture(self, frame: FilmFrame) -> np.ndarray:
        """The picture of a frame, shape (height, width, 3), uint8; height and width are even."""
        initial_state = frame.step.after.initial_state
        goal = goal_of(self._task, initial_state)
        self._view.show(int(initial_state.world[0]), goal, frame.pose, frame.dynamic_obstacles)
        return self._view.chase_picture(*_CHASE_SIZE)

    def legend(self, frame: FilmFrame, scene: Scene) -> list[Mark]:
        """What the colours mean, and a scale."""
        return [*_marks(frame, scene, "disc"), Mark("tiles of 1 m", _TILE_COLOUR, "area")]

    def close(self) -> None:
        self._view.close()


FilmCamera = AboveCamera | ChaseCamera
CAMERAS: dict[str, type[FilmCamera]] = {"above": AboveCamera, "chase": ChaseCamera}


def world_of(frame: FilmFrame, scene: Scene) -> World:
    """The world of a frame's episode."""
    return scene.spec.worlds[int(frame.step.after.initial_state.world[0])]


def _marks(frame: FilmFrame, scene: Scene, goal_shape: str) -> list[Mark]:
    marks = [Mark("wall", WALL, "area")]
    if frame.dynamic_obstacles is not None:
        marks.append(Mark("moving obstacle", DYNAMIC_OBSTACLE, "area"))
    return [*marks, Mark("goal", GOAL, goal_shape)] if scene.task.goal_task else marks


def add_caption(picture: np.ndarray, frame: FilmFrame, scene: Scene) -> np.ndarray:
    """Add a caption below a picture (height, width, 3), uint8, and centre the picture if the caption is wider."""
    height, width, _ = picture.shape
    failed = bool(frame.step.info["failed"])
    caption = draw_caption(max(_MIN_CAPTION_WIDTH, width), caption_values(frame, scene), failed)
    image = Image.new("RGB", (caption.width, height + CAPTION_HEIGHT), FLOOR)
    image.paste(Image.fromarray(picture), ((image.width - width) // 2, 0))
    image.paste(caption, (0, height))
    return np.array(image)


def caption_values(frame: FilmFrame, scene: Scene) -> dict[str, str]:
    """Texts of a caption by label."""
    step, (v, w) = frame.step, frame.step.after.twist[0]
    status = {"ended": frame.ended} if frame.ended else {"action": scene.actions.describe(step.action)}
    if step.intervention:
        status = {**status, "filter": step.intervention}
    speeds = {"v [m/s]": f"{v:z.2f}", "w [rad/s]": f"{w:+z.2f}"}
    reward = {"reward": _rounded(step.reward, "+"), "return": _rounded(step.episode_return)}
    return {"time [s]": f"{frame.time:.1f}", **speeds, **status, **reward}


def _rounded(number: float, sign: str = "-") -> str:
    """A number with three digits, or all digits before the point."""
    return f"{number:{sign}z{'.3g' if abs(number) < 100 else '.0f'}}"


def draw_caption(width: int, values: Mapping[str, str], failed: bool = False) -> Image.Image:
    """Draw each value below its label; the ending of a failed episode is red."""
    image, column_width = Image.new("RGB", (width, CAPTION_HEIGHT), STRIP), width / len(values)
    draw = ImageDraw.Draw(image)
    for column, (label, value) in enumerate(values.items()):
        x, colour = (column + 0.5) * column_width, FAILED if failed and label == "ended" else BODY
        draw.text((x, 13), label, LABEL, fitted_font(label, _LABEL_SIZE, column_width), anchor="mm")
        draw.text((x, 33), value, colour, fitted_font(value, _VALUE_SIZE, column_width), anchor="mm")
    return image
