"""Charts of the report: learning curves, paths and heat maps, as SVG whose text is text.

No chart contains names that users chose: they belong to the page, which escapes them.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import EngFormatter, FuncFormatter, PercentFormatter

from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.rendering.colours import DYNAMIC_OBSTACLE, FAILED, FLOOR, GOAL, PATH, START, WALL
from tb2rl.tasks.outcome import OBSTACLE_COLLISION
from tb2rl.viz.curves import Curve, SeedCurves
from tb2rl.viz.pictures import goals_in, group_by_world
from tb2rl.worlds import World
from tb2rl.worlds.world import box_polygons

# The first colours are distinct for the colour-blind, too (Okabe and Ito 2008).
GROUP_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7f7f7f", "#e69f00", "#56b4e9", "#8c564b")
ACTION_COLOURS = ("#9ecae9", "#e69f00", "#4b3a8c", "#009e73", "#cc79a7", "#f0e442", "#d55e00", "#6b7280")
WIDTH = 4.2  # [in] a phone shows it nearly as large, so its text stays readable
MAX_WORLDS, _COLUMNS = 12, 3  # of one figure
_DPI = 120  # of rasterized parts, because thousands of path segments would be megabytes as SVG
_CELL, _MAX_CELLS = 0.1, 150  # [m] side of a cell of the heat map, most cells in a row
_MARKED_POINTS = 30  # up to which curves have a marker at each point
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "tb2rl",  # for reproducible files
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.use_mathtext": False,
    "text.parse_math": False,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "grid.color": "#dddddd",
}


def distinct_colours(count: int, preferred: Sequence[str]) -> Sequence[str]:
    """The first preferred colours, or hues of one colour map if these are too few."""
    hues = colormaps["turbo"](np.linspace(0, 1, count))
    return preferred[:count] if count <= len(preferred) else [to_hex(hue) for hue in hues]


def chart(label_x: str, label_y: str) -> tuple[Figure, Axes]:
    """A figure with horizontal grid lines."""
    figure = Figure(figsize=(WIDTH, 0.62 * WIDTH), layout="constrained")
    axes = figure.add_subplot(xlabel=label_x, ylabel=label_y)
    axes.grid(axis="y")
    return figure, axes


@matplotlib.rc_context(STYLE)
def draw_curves(groups: Sequence[SeedCurves], label: str, is_rate: bool) -> Markup:
    """Learning curves; of several seeds also the mean and its interval."""
    figure, axes = chart("control steps", label)
    for i, group in enumerate(groups):
        mean, colour = group.mean, group.colour
        if len(group.curves) > 1:
            for j, curve in enumerate(map(Curve.thinned, group.curves)):
                axes.plot(curve.steps, curve.values, color=colour, linewidth=0.7, alpha=0.5, gid=f"seed-{i}-{j}")
            axes.fill_between(mean.steps, *group.interval.T, color=colour, alpha=0.2, linewidth=0, gid=f"interval-{i}")
        marker = "." if len(mean.steps) <= _MARKED_POINTS else ""
        axes.plot(mean.steps, mean.values, color=colour, linewidth=1.8, marker=marker, gid=f"mean-{i}")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.set_xlim(left=0)
    if is_rate:
        axes.set_ylim(-0.03, 1.03)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    return svg(figure)


@matplotlib.rc_context(STYLE)
def draw_episodes(evaluation: Evaluation) -> Markup:
    """Paths of episodes with starts, failures, goals and routes of dynamic obstacles; of many worlds only some.

    Each world has axes of its own, worlds with failures first. Collisions with dynamic obstacles have their own colour.
    """
    scene = evaluation.scene
    by_world = group_by_world(evaluation.episodes).items()
    worlds = dict(sorted(by_world, key=lambda item: not any(episode.failed for episode in item[1]))[:MAX_WORLDS])
    figure, axes_of_worlds = world_figure([scene.spec.worlds[world] for world in worlds])
    for axes, (world, episodes) in zip(axes_of_worlds, worlds.items(), strict=True):
        paths, suffix = [episode.path for episode in episodes], f"-{world}" * (len(worlds) > 1)
        axes.add_collection(LineCollection(paths, colors=PATH, linewidths=0.6, alpha=0.3, rasterized=True))
        mark(axes, [path[0] for path in paths], s=9, color=START, linewidths=0, zorder=3, gid=f"starts{suffix}")
        for group in scene.spec.dynamic_obstacles_in(world):
            axes.plot(*np.reshape(group.route, (-1, 2)).T, color=DYNAMIC_OBSTACLE, linewidth=1.2, alpha=0.3)
        failed = [(episode.ended == OBSTACLE_COLLISION, episode.path[-1]) for episode in episodes if episode.failed]
        cross: dict[str, Any] = {"s": 22, "marker": "x", "linewidths": 1.2, "zorder": 4}
        hits, failures = ([end for dynamic, end in failed if dynamic == kind] for kind in (True, False))
        mark(axes, hits, **cross, color=DYNAMIC_OBSTACLE, gid=f"obstacle-collisions{suffix}")
        mark(axes, failures, **cross, color=FAILED, gid=f"failures{suffix}")
        mark_goals(axes, goals_in(scene, world, episodes), f"goal{suffix}")
    return svg(figure)


@matplotlib.rc_context(STYLE)
def draw_heat_map(evaluation: Evaluation) -> Markup:
    """Share of the time of all episodes in each cell of the first world."""
    x0, y0, x1, y1 = evaluation.scene.world.bounds
    x, y = np.concatenate([episode.path[1:] for episode in evaluation.episodes]).T
    side = max(_CELL, (x1 - x0) / _MAX_CELLS, (y1 - y0) / _MAX_CELLS)
    columns, rows = int(np.ceil((x1 - x0) / side)), int(np.ceil((y1 - y0) / side))
    bounds = [(x0, x0 + columns * side), (y0, y0 + rows * side)]
    shares = np.histogram2d(x, y, bins=(columns, rows), range=bounds)[0] / len(x)
    largest = shares.max() or 1.0  # 0: the robots were never within the bounds
    figure, (axes,) = world_figure([evaluation.scene.world])
    image = axes.imshow(
        np.ma.masked_equal(shares, 0.0).T,
        origin="lower",
        extent=(*bounds[0], *bounds[1]),
        cmap="YlGnBu",
        norm=LogNorm(largest / 1000, largest),
        interpolation="nearest",
    )
    figure.set_figheight(figure.get_figheight() + 0.5)
    percent = FuncFormatter(lambda share, _: f"{100 * share:g} %")
    bar = figure.colorbar(image, ax=axes, location="bottom", aspect=40, shrink=0.9, format=percent)
    bar.outline.set_visible(False)
    return svg(figure)


def world_figure(worlds: Sequence[World]) -> tuple[Figure, list[Axes]]:
    """A figure with axes for each world, in which its obstacles are drawn; ticks only for a single world."""
    columns = min(len(worlds), _COLUMNS)
    rows = math.ceil(len(worlds) / columns)
    x0, y0, x1, y1 = worlds[0].bounds
    height = WIDTH / columns * min((y1 - y0) / (x1 - x0), 1.4)
    figure = Figure(figsize=(WIDTH, rows * max(height, 0.4 * WIDTH / columns)), layout="constrained")
    axes_of_worlds = []
    for i, world in enumerate(worlds):
        x0, y0, x1, y1 = world.bounds
        axes = figure.add_subplot(rows, columns, i + 1, aspect="equal", facecolor=FLOOR, xlim=(x0, x1), ylim=(y0, y1))
        if len(worlds) == 1:
            axes.set(xlabel="x [m]", ylabel="y [m]")
        else:
            axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        walls = [Polygon(np.array(box.exterior.coords)) for box in box_polygons(world.boxes)]
        posts = [Circle((x, y), radius) for x, y, radius in world.posts]
        axes.add_collection(PatchCollection([*walls, *posts], facecolor=WALL, linewidth=0, zorder=2))
        axes_of_worlds.append(axes)
    return figure, axes_of_worlds


def mark(axes: Axes, points: Sequence[Any] | np.ndarray, **style: Any) -> None:
    """Scatter points x, y [m]; there may be none."""
    axes.scatter(*np.reshape(points, (-1, 2)).T, **style)


def mark_goals(axes: Axes, points: Sequence[Any] | np.ndarray, gid: str) -> None:
    mark(axes, points, s=90, color=GOAL, marker="*", edgecolors="black", linewidths=0.5, zorder=5, gid=gid)


def svg(figure: Figure) -> Markup:
    """The figure as an SVG element, without the header of a file."""
    buffer = io.StringIO()
    no_metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(buffer, format="svg", dpi=_DPI, metadata=no_metadata)
    text = buffer.getvalue()
    return Markup(text[text.index("<svg") :])


def with_unique_ids(picture: Markup, number: int) -> Markup:
    """The picture with prefixed ids, because the ids of several charts on a page would clash."""
    return Markup(re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>chart-{number}-", str(picture)))
