"""The 3D scene of the viewer's page: worlds, robots, goals, beams, paths and dynamic obstacles."""

import math
from collections.abc import Sequence
from functools import cache
from itertools import count
from typing import Any

import numpy as np
from PIL import ImageColor

from tb2rl.rendering.above import GOAL_RADIUS
from tb2rl.rendering.colours import BEAM, DYNAMIC_OBSTACLE, FLOOR, GOAL, PATH, WALL
from tb2rl.robots import Robot
from tb2rl.simulation.obstacles.outlines import COS, LENGTH, SIN, WIDTH, X, Y
from tb2rl.worlds import World
from tb2rl.worlds.world import WALL_HEIGHT

_LINE_HEIGHT = 0.02  # [m] of beams and path above the floor, where they do not hide the robot
_GAP = 1.0  # [m] between worlds side by side
_GOAL_HEIGHT, _FLOOR_THICKNESS = 0.06, 0.02  # [m]
_PLAN_COLOUR = "#2ca02c"
_START_COLOUR = (90, 95, 105)  # RGB, unlike the goal's
_NUMBERS = count()  # of scenes
_SKY_LIGHT = 2.5  # intensity of the light from all sides
_HIDDEN = 1e-6  # scale of a shape that is not shown


class LiveScene:
    """Draws robots in worlds that stand side by side.

    Args:
        server: A `ViserServer`.
        robot: The robot.
        worlds: The world of each robot; the attribute, too.
        shared: Whether all robots are in the same world, which is drawn once.
    """

    def __init__(self, server: Any, robot: Robot, worlds: Sequence[World], shared: bool = True) -> None:
        self._server, self.worlds = server, list(worlds)
        server.scene.reset()
        self._root = f"/{next(_NUMBERS)}"  # new names, because pages keep the size of a grid with an old name
        # Shadows and reflections would take most of the time until a browser without a GPU shows its first picture.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(hdri=None)
        server.scene.add_light_hemisphere(f"{self._root}/sky", intensity=_SKY_LIGHT)
        drawn = worlds[:1] if shared else worlds
        offsets = _grid_offsets(drawn)
        self._offsets = np.broadcast_to(offsets, (len(worlds), 2))  # x, y [m]
        for index, (world, offset) in enumerate(zip(drawn, offsets, strict=True)):
            self._add_world(f"{self._root}/worlds/{index}", world, offset)
        low, high = np.hsplit(np.array([world.bounds for world in drawn]) + np.tile(offsets, 2), 2)
        self._bounds = *low.min(axis=0).tolist(), *high.max(axis=0).tolist()  # min x, min y, max x, max y [m]
        model, height = _model(robot)
        self.robots = server.scene.add_batched_glb(f"{self._root}/robots", model, *_frames(np.zeros((len(worlds), 3))))
        self._label_height = height + 0.3  # [m]
        self.goals = self._add_shapes(f"{self._root}/goals", "cylinder", len(worlds), GOAL)
        self._beams = self._add_lines(f"{self._root}/beams", BEAM)
        self._path = self._add_lines(f"{self._root}/path", PATH)
        self._plan = self._add_lines(f"{self._root}/plan", _PLAN_COLOUR)
        self._label = server.scene.add_label(f"{self._root}/filter", "", anchor="bottom-center", visible=False)
        self._goal_label = server.scene.add_label(f"{self._root}/goal", "goal", anchor="bottom-center", visible=False)
        self._start = server.scene.add_label(f"{self._root}/start", "start", anchor="bottom-center", visible=False)
        server.scene.add_cylinder(f"{self._root}/start/disc", 0.1, 0.01, color=_START_COLOUR)
        self._moving: dict[str, Any] = {}  # by shape

    def set_cameras(self) -> None:
        """Let all cameras, also those of pages that will be opened, see all worlds."""
        x0, y0, x1, y1 = self._bounds
        target, distance = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0]), max(x1 - x0, y1 - y0, 2.0)
        position = target + distance * np.array([0.0, -0.55, 0.95])
        for owner in (self._server.initial_camera, *(each.camera for each in self._server.get_clients().values())):
            owner.position, owner.look_at = position, target

    def show_robots(self, poses: np.ndarray, goals: np.ndarray, outlines: np.ndarray | None = None) -> None:
        """Move robots, goals and dynamic obstacles.

        Args:
            poses: x [m], y [m], yaw [rad], shape (robots, 3).
            goals: x, y [m], shape (robots, 2); NaN without a goal.
            outlines: As `RobotState.dynamic_obstacles`, shape (robots, obstacles, 6); None: no obstacles.
        """
        shown = np.array(poses)
        shown[:, :2] += self._offsets
        self.robots.batched_wxyzs, self.robots.batched_positions = _frames(shown)
        has_goal = np.isfinite(goals).all(axis=1)
        positions = np.zeros((len(goals), 3))
        positions[has_goal, :2] = goals[has_goal] + self._offsets[has_goal]
        sizes = np.where(has_goal[:, None], (GOAL_RADIUS, GOAL_RADIUS, _GOAL_HEIGHT), _HIDDEN)
        if not np.array_equal(positions, self.goals.batched_positions):
            self.goals.batched_positions, self.goals.batched_scales = positions, sizes
            self._goal_label.position, self._goal_label.visible = (*positions[0, :2], 0.3), bool(has_goal[0])
        if outlines is None:
            return
        rows, offsets = outlines.reshape(-1, 6), np.repeat(self._offsets, outlines.shape[1], axis=0)
        for shape in ("box", "cylinder"):
            if shape not in self._moving:
                self._moving[shape] = self._add_shapes(f"{self._root}/{shape}", shape, len(rows), DYNAMIC_OBSTACLE)
            _place(self._moving[shape], shape, rows, offsets)

    def show_beams(self, pose: np.ndarray, angles: np.ndarray, ranges: np.ndarray) -> None:
        """Draw the laser beams of the first robot.

        Args:
            pose: x [m], y [m], yaw [rad], shape (3,).
            angles: Directions of the beams in the robot's frame [rad], shape (beams,).
            ranges: Lengths [m], shape (beams,); inf: not drawn.
        """
        start, directions = pose[:2] + self._offsets[0], pose[2] + angles
        lengths = np.where(np.isfinite(ranges), ranges, 0.0)
        ends = start + np.column_stack([lengths * np.cos(directions), lengths * np.sin(directions)])
        self._beams.points = _segments(np.broadcast_to(start, ends.shape), ends, _LINE_HEIGHT)

    def show_path(self, positions: np.ndarray, plan: np.ndarray) -> None:
        """Draw path, start and plan of the first robot, through positions x, y [m], each of shape (n, 2)."""
        self._start.position, self._start.visible = (*(positions[0] + self._offsets[0]), 0.0), True
        for lines, points in ((self._path, positions), (self._plan, plan)):
            shown = points + self._offsets[0]
            lines.points = _segments(shown[:-1], shown[1:], 2 * _LINE_HEIGHT)  # above the beams

    def show_label(self, text: str, pose: np.ndarray) -> None:
        """Show a text above the first robot at a pose (3,), such as the reason of a filter; empty: no text."""
        if text != self._label.text:
            self._label.text, self._label.visible = text, bool(text)
        if text:
            self._label.position = (*(pose[:2] + self._offsets[0]), self._label_height)

    def _add_world(self, name: str, world: World, offset: np.ndarray) -> None:
        x0, y0, x1, y1 = np.array(world.bounds) + np.tile(offset, 2)
        centre, add = ((x0 + x1) / 2, (y0 + y1) / 2), self._server.scene
        colour, size, below = ImageColor.getrgb(FLOOR), (x1 - x0, y1 - y0, _FLOOR_THICKNESS), -_FLOOR_THICKNESS
        add.add_box(f"{name}/floor", colour, size, position=(*centre, below), cast_shadow=False)
        grid = {"cell_size": 1.0, "section_size": 1.0, "section_color": (205, 198, 186), "section_thickness": 1.0}
        add.add_grid(f"{name}/grid", x1 - x0, y1 - y0, position=(*centre, 0.0), **grid)
        x, y, half_length, half_width, cos, sin = world.boxes.T
        boxes, posts = np.column_stack([x, y, cos, sin, half_length, half_width]), np.zeros((len(world.posts), 6))
        posts[:, [X, Y, LENGTH]], posts[:, COS] = world.posts, 1.0
        for shape, outlines in (("box", boxes), ("cylinder", posts)):
            if len(outlines):
                _place(self._add_shapes(f"{name}/{shape}", shape, len(outlines), WALL), shape, outlines, offset)

    def _add_shapes(self, name: str, shape: str, count: int, colour: str) -> Any:
        mesh, frames = _unit_shape(shape), _frames(np.zeros((count, 3)))
        options = {"batched_colors": _linear(colour), "batched_scales": np.full((count, 3), _HIDDEN)}
        add = self._server.scene.add_batched_meshes_simple
        return add(name, mesh.vertices, mesh.faces, *frames, flat_shading=True, lod="off", **options)

    def _add_lines(self, name: str, colour: str) -> Any:
        points, options = np.zeros((1, 2, 3), dtype=np.float32), {"thickness": 1.5, "thickness_units": "screen"}
        return self._server.scene.add_line_segments(name, points, ImageColor.getrgb(colour), **options)


def _grid_offsets(worlds: Sequence[World]) -> np.ndarray:
    """Offsets x, y [m] that place worlds side by side in a square grid, shape (worlds, 2)."""
    low, high = np.hsplit(np.array([world.bounds for world in worlds]), 2)
    width, height = (high - low).max(axis=0) + _GAP
    rows, columns = np.divmod(np.arange(len(worlds)), math.ceil(math.sqrt(len(worlds))))
    return np.column_stack([columns * width, -rows * height]) - (low - low[0])


def _frames(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions w, x, y, z, shape (n, 4), and positions on the floor [m], shape (n, 3), of poses (n, 3)."""
    half, zeros = poses[:, 2] / 2, np.zeros(len(poses))
    return np.column_stack([np.cos(half), zeros, zeros, np.sin(half)]), np.column_stack([poses[:, :2], zeros])


def _segments(starts: np.ndarray, ends: np.ndarray, height: float) -> np.ndarray:
    """Line segments at a height [m] between points (n, 2), shape (n, 2, 3); one of length 0 if there are none."""
    segments = np.full((max(len(starts), 1), 2, 3), height, dtype=np.float32)
    if len(starts):
        segments[:, 0, :2], segments[:, 1, :2] = starts, ends
    return segments


def _place(handle: Any, shape: str, outlines: np.ndarray, offsets: np.ndarray) -> None:
    """Place shapes that are as high as walls.

    Args:
        handle: The shapes.
        shape: "box" or "cylinder"; outlines of other shapes are hidden.
        outlines: As `RobotState.dynamic_obstacles`, shape (n, 6).
        offsets: Of the worlds: x, y [m], shape (2,) or (n, 2).
    """
    length, width = outlines[:, LENGTH], outlines[:, WIDTH]
    yaws, heights = np.arctan2(outlines[:, SIN], outlines[:, COS]), np.full(len(outlines), WALL_HEIGHT)
    handle.batched_wxyzs, positions = _frames(np.column_stack([outlines[:, [X, Y]] + offsets, yaws]))
    positions[:, 2] = WALL_HEIGHT / 2
    is_box, sides = width > 0, (2 * length, 2 * width) if shape == "box" else (length, length)
    is_shown = is_box if shape == "box" else (length > 0) & ~is_box
    scales = np.where(is_shown[:, None], np.column_stack([*sides, heights]), _HIDDEN)
    handle.batched_positions, handle.batched_scales = positions, scales


def _linear(colour: str) -> tuple[int, ...]:
    """A colour without the gamma of sRGB (IEC 61966-2-1), which the page adds to batched shapes once more."""
    return tuple(round(255 * (((value / 255) + 0.055) / 1.055) ** 2.4) for value in ImageColor.getrgb(colour))


@cache
def _unit_shape(name: str) -> Any:
    """A box with sides of 1 m, or a "cylinder" with a radius and a height of 1 m, around the origin."""
    import trimesh  # imported here, because it takes a second, in which the browser can start

    return trimesh.creation.box((1, 1, 1)) if name == "box" else trimesh.creation.cylinder(1.0, 1.0, sections=32)


@cache
def _model(robot: Robot) -> tuple[bytes, float]:
    """The visual shapes of a robot's URDF file as a binary glTF file, and their height [m]."""
    import yourdfpy  # imported here like trimesh, which it imports

    scene = yourdfpy.URDF.load(str(robot.urdf), load_collision_meshes=False).scene
    return scene.to_mesh().export(file_type="glb"), float(scene.bounds[1, 2])
