"""Charts of the report as SVG: learning curves, paths and heat maps.

Charts contain no names from users, because `Markup` is not escaped; the page itself shows and escapes names.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.rendering.colours import BODY, DYNAMIC_OBSTACLE, FAILED, FLOOR, GOAL, PATH, START, WALL
from tb2rl.tasks.task import DYNAMIC_COLLISION
from tb2rl.viz.pictures import goals_in, group_by_world
from tb2rl.worlds import World

# Distinct for the colour-blind, too; most colours are those of Okabe and Ito 2008.
GROUP_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7f7f7f", "#e69f00", "#56b4e9", "#8c564b")
ACTION_COLOURS = ("#9ecae9", "#e69f00", "#4b3a8c", "#009e73", "#cc79a7", "#f0e442", "#d55e00", "#6b7280")
WIDTH = 4.2  # [in] width of a figure; small, so that the text stays readable on a phone
MAX_WORLDS, _MAX_COLUMNS = 12, 3  # of a figure with several worlds
_MIN_CELL_SIDE, _MAX_CELLS = 0.1, 150  # of a heat map: side of a cell [m], cells along a side of the map
MAX_POINTS = 120  # maximum number of points of a drawn curve
_MAX_MARKERS = 30  # curves with more points have no markers
STYLE = matplotlib.rc_params_from_file(Path(__file__).with_name("charts.mplstyle"), use_default_template=False)


@dataclass(frozen=True)
class Curve:
    """A quantity of one training over control steps."""

    steps: np.ndarray  # [control steps], ascending, shape (points,)
    values: np.ndarray  # shape (points,)

    def downsample(self) -> Curve:
        """At most `MAX_POINTS` of the points, including the first and the last one."""
        selected = np.linspace(0, len(self.steps) - 1, min(MAX_POINTS, len(self.steps))).round().astype(int)
        return Curve(self.steps[selected], self.values[selected])


@dataclass(frozen=True)
class SeedCurves:
    """Curves of trainings that differ only in their seed; each has at least one point."""

    name: str
    colour: str
    curves: Sequence[Curve]

    @cached_property
    def mean(self) -> Curve:
        """The mean curve over the steps that all curves cover."""
        first = max(curve.steps[0] for curve in self.curves)
        last = min(curve.steps[-1] for curve in self.curves)
        steps = np.unique(np.concatenate([curve.steps for curve in self.curves]))
        steps = steps[(steps >= first) & (steps <= last)]
        return Curve(steps, self._interpolate(steps).mean(axis=0)).downsample()

    @cached_property
    def interval(self) -> np.ndarray:
        """The 95 % bootstrap interval of each point of `mean`, shape (points, 2)."""
        values_by_step = self._interpolate(self.mean.steps).T
        return np.array([bootstrap_interval(values) for values in values_by_step]).reshape(-1, 2)

    @property
    def is_cut(self) -> bool:
        """Whether some curves continue after the last step of `mean`."""
        return len({curve.steps[-1] for curve in self.curves}) > 1

    def _interpolate(self, steps: np.ndarray) -> np.ndarray:
        """Values of all curves at some steps, shape (curves, len(steps))."""
        return np.array([np.interp(steps, curve.steps, curve.values) for curve in self.curves])


def distinct_colours(count: int, preferred: Sequence[str]) -> Sequence[str]:
    """Distinct colours: the first preferred ones, or colours of a colour map if `count` exceeds them."""
    colours = colormaps["turbo"](np.linspace(0, 1, count))
    return preferred[:count] if count <= len(preferred) else [to_hex(colour) for colour in colours]


def chart(label_x: str, label_y: str) -> tuple[Figure, Axes]:
    """A figure with horizontal grid lines."""
    figure = Figure(figsize=(WIDTH, 0.62 * WIDTH), layout="constrained")
    axes = figure.add_subplot(xlabel=label_x, ylabel=label_y)
    axes.grid(axis="y")
    axes.locator_params(axis="x", nbins=6)  # else labels such as 1.25M touch
    return figure, axes


@matplotlib.rc_context(STYLE)
def draw_curves(groups: Sequence[SeedCurves], label: str, is_rate: bool) -> Markup:
    """Learning curves; a group of several seeds also has its mean with a 95 % bootstrap interval."""
    figure, axes = chart("control steps", label)
    for i, group in enumerate(groups):
        mean, colour = group.mean, group.colour
        if len(group.curves) > 1:
            for j, curve in enumerate(group.curves):
                points = curve.downsample()
                axes.plot(points.steps, points.values, color=colour, linewidth=0.7, alpha=0.5, gid=f"seed-{i}-{j}")
            axes.fill_between(mean.steps, *group.interval.T, color=colour, alpha=0.2, linewidth=0, gid=f"interval-{i}")
        marker = "." if len(mean.steps) <= _MAX_MARKERS else ""
        axes.plot(mean.steps, mean.values, color=colour, linewidth=1.8, marker=marker, gid=f"mean-{i}")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.set_xlim(left=0)
    if is_rate:
        axes.set_ylim(-0.03, 1.03)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    return svg(figure)


@matplotlib.rc_context(STYLE)
def draw_episodes(evaluation: Evaluation) -> Markup:
    """Paths of episodes with starts, failures, goals and routes of dynamic obstacles.

    Each world has its own axes. At most `MAX_WORLDS` worlds are drawn, worlds with failures first. Collisions with
    dynamic obstacles have a separate colour.
    """
    scene = evaluation.scene
    by_world = group_by_world(evaluation.episodes).items()
    drawn_worlds = dict(sorted(by_world, key=lambda item: not any(episode.failed for episode in item[1]))[:MAX_WORLDS])
    figure, axes_by_world = world_figure([scene.spec.worlds[world] for world in drawn_worlds])
    for axes, (world, episodes) in zip(axes_by_world, drawn_worlds.items(), strict=True):
        paths, suffix = [episode.path for episode in episodes], f"-{world}" * (len(drawn_worlds) > 1)
        axes.add_collection(LineCollection(paths, colors=PATH, linewidths=0.6, alpha=0.3, rasterized=True))
        mark(axes, [path[0] for path in paths], s=9, color=START, linewidths=0, zorder=3, gid=f"starts{suffix}")
        for obstacle_group in scene.spec.dynamic_obstacles_in(world):
            axes.plot(*np.reshape(obstacle_group.route, (-1, 2)).T, color=DYNAMIC_OBSTACLE, linewidth=1.2, alpha=0.3)
        failed = [episode for episode in episodes if episode.failed]
        for gid, colour, is_dynamic in (("dynamic-collisions", DYNAMIC_OBSTACLE, True), ("failures", FAILED, False)):
            ends = [episode.path[-1] for episode in failed if (episode.ended == DYNAMIC_COLLISION) == is_dynamic]
            mark(axes, ends, s=22, color=colour, marker="x", linewidths=1.2, zorder=4, gid=f"{gid}{suffix}")
        mark_goals(axes, goals_in(scene, world, episodes), f"goal{suffix}")
    return svg(figure)


@matplotlib.rc_context(STYLE)
def draw_heat_map(evaluation: Evaluation) -> Markup:
    """Heat map of the positions in a single world: percentage of all positions in each cell."""
    x0, y0, x1, y1 = evaluation.scene.world.bounds
    x, y = np.concatenate([episode.path for episode in evaluation.episodes]).T
    side = max(_MIN_CELL_SIDE, (x1 - x0) / _MAX_CELLS, (y1 - y0) / _MAX_CELLS)
    edges = [np.arange(x0, x1 + side, side), np.arange(y0, y1 + side, side)]
    shares = np.histogram2d(x, y, edges, weights=np.full(len(x), 100 / len(x)))[0].T  # [%]
    max_share = shares.max() or 1.0  # the maximum is 0 if the robots were never within the bounds
    figure, (axes,) = world_figure([evaluation.scene.world])
    scale = LogNorm(max_share / 1000, max_share)
    image = axes.pcolormesh(*edges, np.ma.masked_equal(shares, 0.0), cmap="YlGnBu", norm=scale, rasterized=True)
    figure.set_figheight(figure.get_figheight() + 0.5)
    bar = figure.colorbar(image, ax=axes, location="bottom", aspect=40, shrink=0.9, format="{x:g} %")
    bar.outline.set_visible(False)
    return svg(figure)


def world_figure(worlds: Sequence[World]) -> tuple[Figure, list[Axes]]:
    """A figure with the obstacles of each world on its own axes; axes have ticks if there is one world."""
    columns = min(len(worlds), _MAX_COLUMNS)
    rows, (x0, y0, x1, y1) = math.ceil(len(worlds) / columns), worlds[0].bounds
    height = rows * WIDTH / columns * np.clip((y1 - y0) / (x1 - x0), 0.4, 1.4)
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    ticks: dict[str, Any] = {"xlabel": "x [m]", "ylabel": "y [m]"} if len(worlds) == 1 else {"xticks": [], "yticks": []}
    for i, world in enumerate(worlds):
        x0, y0, x1, y1 = world.bounds
        axes = figure.add_subplot(rows, columns, i + 1, aspect="equal", facecolor=FLOOR, xlim=(x0, x1), ylim=(y0, y1))
        axes.set(**ticks)
        axes.spines[:].set_visible(False)
        outlines = [np.array(outline.exterior.coords) for outline in world.outlines()]
        axes.add_collection(PolyCollection(outlines, facecolor=WALL, linewidth=0, zorder=2))
    return figure, figure.axes


def mark(axes: Axes, points: Sequence[Any] | np.ndarray, **style: Any) -> None:
    """Mark points x, y [m], of which there may be none."""
    axes.scatter(*np.reshape(points, (-1, 2)).T, **style)


def mark_goals(axes: Axes, points: Sequence[Any] | np.ndarray, gid: str) -> None:
    mark(axes, points, s=90, color=GOAL, marker="*", edgecolors=BODY, linewidths=0.5, zorder=5, gid=gid)


def svg(figure: Figure) -> Markup:
    """The figure as an SVG element, without an XML header; black becomes the text colour of the page."""
    buffer = io.StringIO()
    no_metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(buffer, format="svg", metadata=no_metadata)
    text = buffer.getvalue()
    return Markup(text[text.index("<svg") :].replace("#000000", "currentColor"))
