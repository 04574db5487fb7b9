"""Sections of the report for drives from ROS bags: path, speeds and nearest range."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from markupsafe import Markup

from tb2rl.calibration.replay import WINDOW, Replay
from tb2rl.deploy.bags.reading import Drive
from tb2rl.rendering.colours import BEAM, FAILED, PATH, START
from tb2rl.viz.charts import STYLE, chart, mark, mark_goals, svg, world_figure
from tb2rl.viz.pictures import extend_bounds
from tb2rl.worlds import World

EMPTY: Mapping[str, Replay] = {}
_MAX_POINTS = 600  # maximum number of points of a line; a phone has no more pixels
_MIN_HEIGHT = 0.01  # of the y axis: below, differences are rounding errors


@dataclass(frozen=True)
class ReplaySection:
    """The commands of a drive in a simulator, with charts."""

    name: str  # of the policy, run or robot file whose robot was simulated
    replay: Replay
    path: Markup
    distances: Markup


@dataclass(frozen=True)
class DriveSection:
    """A drive with its charts."""

    drive: Drive
    world: str  # name of the world; "" without a world
    path: Markup
    speed: Markup  # measured and commanded
    turn_rate: Markup  # measured and commanded
    nearest: Markup | None  # None without scans
    replay: ReplaySection | None = None


def drive_section(drive: Drive, world: World | None = None, replays: Mapping[str, Replay] = EMPTY) -> DriveSection:
    """Draw the charts of a drive, with an optional world.

    A path by odometry is drawn from the start of the world, because odometry has no fixed frame in the world.

    Args:
        drive: The drive.
        world: Its world.
        replays: At most one replay of the drive, by name.
    """
    measured, commands = drive.trajectory, drive.commands  # columns: time, x, y, yaw, v, w; and time, v, w
    return DriveSection(
        drive,
        world.name if world else "",
        _draw_path(drive, world),
        _draw_lines("speed [m/s]", measured[:, [0, 4]], commands[:, [0, 1]]),
        _draw_lines("turn rate [rad/s]", measured[:, [0, 5]], commands[:, [0, 2]]),
        _draw_lines("nearest range [m]", _downsample(drive.scan_minima, np.min)) if len(drive.scan_minima) else None,
        *(_replay_section(drive, world, name, each) for name, each in replays.items()),
    )


def _replay_section(drive: Drive, world: World | None, name: str, replay: Replay) -> ReplaySection:
    distances = _draw_lines(f"apart after {WINDOW:g} s [m]", np.column_stack([replay.times, replay.distances]))
    return ReplaySection(name, replay, _draw_path(drive, world, list(replay.paths)), distances)


@matplotlib.rc_context(STYLE)
def _draw_path(drive: Drive, world: World | None, simulated: Sequence[np.ndarray] = ()) -> Markup:
    path = drive.trajectory[:, 1:3] if world is None or len(drive.truth) else drive.path_from(world.start)
    world = world or World.from_shapes("", start=(0.0, 0.0, 0.0), bounds=(*path.min(axis=0) - 1, *path.max(axis=0) + 1))
    figure, (axes,) = world_figure([extend_bounds(world, path)])
    for each in simulated:  # wider and below, because both lines may be the same
        axes.plot(*each.T, color=BEAM, linewidth=3, gid="simulated")
    axes.plot(*_downsample(path).T, color=PATH, linewidth=1.2, gid="drive")
    mark(axes, [path[0]], s=22, color=START, linewidths=0, zorder=3, gid="start")
    contact_times = drive.bumper[np.diff(drive.bumper[:, 1], prepend=0.0) > 0.0, 0]  # times at which contacts begin
    contacts = np.column_stack([np.interp(contact_times, drive.trajectory[:, 0], column) for column in path.T])
    mark(axes, contacts, s=28, color=FAILED, marker="x", linewidths=1.4, zorder=4, gid="contacts")
    if len(drive.goals) and len(drive.truth):  # only then are path and goals in the same frame
        mark_goals(axes, np.unique(drive.goals[:, 1:], axis=0), "goal")
    return svg(figure)


@matplotlib.rc_context(STYLE)
def _draw_lines(label: str, measured: np.ndarray, commanded: np.ndarray | None = None) -> Markup:
    """Lines over time, from rows of time [s] and value."""
    figure, axes = chart("time [s]", label)
    if commanded is not None:
        axes.step(*_downsample(commanded).T, where="post", color=BEAM, linewidth=3, gid="line-commanded")
    axes.plot(*_downsample(measured).T, color=PATH, linewidth=1.2, gid="line-measured")
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, low + _MIN_HEIGHT))
    return svg(figure)


def _downsample(rows: np.ndarray, reduce: Callable[..., np.ndarray] = np.mean) -> np.ndarray:
    """At most `_MAX_POINTS` rows, each reduced from a block of consecutive rows."""
    if len(rows) <= _MAX_POINTS:
        return rows
    return np.array([reduce(block, axis=0) for block in np.array_split(rows, _MAX_POINTS)])
