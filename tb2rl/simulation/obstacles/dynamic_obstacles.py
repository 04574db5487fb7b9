"""The dynamic obstacles of all environments. Their random numbers come from `obstacle_seed` of the initial state."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.simulation.obstacles import outlines
from tb2rl.simulation.obstacles.outlines import EMPTY, FIELDS, OBSTACLE_TYPE, PATH, PERSON, TO_TARGETS, ObstacleArrays
from tb2rl.simulation.random_streams import StreamSource
from tb2rl.simulation.spec import InitialState, SimulationSpec
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
from tb2rl.worlds.geometry import clearance_at

_CANDIDATES = 8  # random start poses for each obstacle, which starts at the first pose with room
# [m] Least gap between the robot's centre and an obstacle at the start, if a candidate with room has it.
_START_MARGIN = 1.5
_CONSTANT_COLUMNS = [FIELDS.index("length"), FIELDS.index("width"), *range(FIELDS.index("kind"), len(FIELDS))]
_EMPTY_ROW = np.eye(len(FIELDS))[outlines.COS]  # row without an obstacle: heading 0, all other values 0
_SEED_COUNT = 2.0**53  # number of different float64 random numbers in [0, 1)


class SimulatedObstacles:
    """The dynamic obstacles of all environments, and their random start poses.

    Args:
        spec: The worlds and their dynamic obstacles.
        num_envs: Number of environments.

    Attributes:
        table: Rows of `tb2rl.simulation.obstacles.outlines.FIELDS`, shape (num_envs, obstacles, len(FIELDS)).
        streams: Key of each random stream, and how many numbers it has supplied, shape (num_envs, 2).
    """

    def __init__(self, spec: SimulationSpec, num_envs: int) -> None:
        """Make the rows of the obstacles of each world, which become rows of `table` in an episode.

        `_presence` is the probability that an obstacle is present. `_first_of_group` is the obstacle whose random
        number decides whether the whole group is present. Both have the shape (worlds, obstacles).
        """
        worlds = [spec.dynamic_obstacles_in(world) for world in range(len(spec.worlds))]
        path_points: list[tuple[float, float]] = []
        groups = {id(group): group for world_groups in worlds for group in world_groups}  # each group once
        rows = {key: _make_rows(group, path_points) for key, group in groups.items()}
        shape = len(worlds), max(sum(group.count for group in world_groups) for world_groups in worlds)
        self._world_rows, self._presence = np.tile(_EMPTY_ROW, (*shape, 1)), np.ones(shape)
        self._first_of_group = np.zeros(shape, int)
        for world, world_groups in enumerate(worlds):
            first = 0
            for group in world_groups:
                members = world, slice(first, first + group.count)
                self._world_rows[members], self._presence[members] = rows[id(group)], group.presence
                self._first_of_group[members] = first
                first += group.count
        self._spec, self._path_points = spec, np.array(path_points).reshape(-1, 2)
        self.table = np.zeros((num_envs, *self._world_rows.shape[1:]))
        self.streams = np.zeros((num_envs, 2), dtype=np.uint64)

    @property
    def arrays(self) -> Any:
        """Views for compiled code, `ObstacleArrays`; None if there are no dynamic obstacles."""
        if not self.table.shape[1]:
            return None
        return ObstacleArrays(outlines.as_records(self.table, OBSTACLE_TYPE), self.streams, self._path_points)

    @property
    def outlines(self) -> np.ndarray:
        """View of the outlines in the table, see `RobotState.dynamic_obstacles`."""
        return self.table[:, :, outlines.OUTLINE]

    def sizes(self, world: int) -> np.ndarray:
        """Columns `LENGTH` and `WIDTH` of all obstacles that may be in a world [m], shape (obstacles, 2)."""
        return self._world_rows[world][:, [outlines.LENGTH, outlines.WIDTH]]

    def reset_at(self, indices: np.ndarray, initial_state: InitialState) -> None:
        """Place the obstacles of environments `indices` (n,) for new episodes; `initial_state` has n rows."""
        if not self.table.shape[1]:
            return
        worlds, starts = initial_state.world.astype(int), initial_state.records
        table, keys = self._world_rows[worlds], (starts["obstacle_seed"] * _SEED_COUNT).astype(np.uint64)
        obstacles, count = outlines.as_records(table, OBSTACLE_TYPE), table.shape[1]
        source = StreamSource(keys, np.zeros(len(indices), dtype=np.uint64))
        random_numbers = source.uniform(count * (_CANDIDATES * 4 + 1)).reshape(len(indices), count, -1)
        speeds = obstacles["min_speed"], obstacles["max_speed"]
        obstacles["speed"] = speeds[0] + random_numbers[:, :, -1] * (speeds[1] - speeds[0])
        candidates = random_numbers[:, :, :-1].reshape(len(indices), count, _CANDIDATES, 4)
        if (obstacles["kind"] > PATH).any():
            candidate_worlds = np.repeat(worlds, count * _CANDIDATES)
            poses = self._spec.sample_poses(candidate_worlds, candidates.reshape(-1, 4), self._spec.robot.radius)
            candidates = np.concatenate([poses.reshape(*candidates.shape[:3], 3), candidates[..., :1]], axis=3)
        else:
            candidates = candidates[..., [1, 2, 3, 0]]  # only the last is used, see `_place_on_path`
        if (self._presence < 1.0).any():
            group_draws = np.take_along_axis(source.uniform(count), self._first_of_group[worlds], axis=1)
            table[group_draws >= self._presence[worlds]] = _EMPTY_ROW
        _place_obstacles(obstacles, self._path_points, candidates, starts, self._spec.spatial_index)
        self.table[indices], self.streams[indices, 0], self.streams[indices, 1] = table, keys, source.counts

    def state(self) -> dict[str, np.ndarray]:
        """Table and random streams."""
        return {"table": self.table.copy(), "streams": self.streams.copy()}

    def restore(self, state: Mapping[str, Any], initial_state: InitialState) -> None:
        """Continue from a `state`, in episodes with these initial states.

        Raises:
            ValueError: If the obstacles are not those of the episodes' worlds, or have impossible values.
        """
        table, streams = np.array(state["table"]), np.array(state["streams"])
        rows, world_rows = outlines.as_records(table, OBSTACLE_TYPE), self._world_rows[initial_state.world.astype(int)]
        same = (table[..., _CONSTANT_COLUMNS] == world_rows[..., _CONSTANT_COLUMNS]).all(axis=2)
        same |= (table == _EMPTY_ROW).all(axis=2)
        valid = (rows["next"] >= 0) & (rows["next"] < np.maximum(rows["count"], 1))
        valid &= rows["speed"] <= rows["max_speed"]
        if not (np.isfinite(table).all() and (same & valid).all()):
            raise ValueError("the state has other dynamic obstacles, or impossible values")
        self.table, self.streams = table, streams


def _make_rows(group: DynamicObstacles, path_points: list[tuple[float, float]]) -> np.ndarray:
    """Make a row for each person, post and box of a group, in this order; append the path's points to `path_points`."""
    table = np.zeros((group.count, len(FIELDS)))
    rows = outlines.as_records(table, OBSTACLE_TYPE)
    people, boxes = slice(group.people), slice(group.people + group.posts, None)
    rows["cos"], rows["length"], rows["kind"] = 1.0, group.radius, TO_TARGETS
    rows["min_speed"], rows["max_speed"] = group.speed
    if group.path is not None:
        loop = group.path if group.closed else (*group.path, *group.path[-2:0:-1])  # back and forth
        rows["kind"], rows["first"], rows["count"] = PATH, len(path_points), len(loop)
        path_points.extend(loop)
    rows["kind"][people], rows["avoids_robot"][people] = PERSON, group.avoid_robot
    rows["length"][boxes], rows["width"][boxes] = group.size[0] / 2, group.size[1] / 2
    return table


@njit(cache=True)
def _place_obstacles(obstacles, path_points, candidates, starts, spatial_index):
    """Put each obstacle at the first of its candidates with room, else at the candidate farthest from the robot.

    `candidates` (num_envs, obstacles, n, 4) are x, y [m], heading [rad], and a share in [0, 1) of the path, for
    obstacles on a path. An obstacle on a path has room anywhere except near the robot.
    """
    for i in range(obstacles.shape[0]):
        for k in range(obstacles.shape[1]):
            obstacle = obstacles[i, k]
            if obstacle.kind == EMPTY:
                continue
            largest_gap, radius = -np.inf, outlines.outer_radius(obstacle)
            best, best_next_point = candidates[i, k, 0], 0
            for n in range(candidates.shape[2]):
                candidate = candidates[i, k, n].copy()
                next_point = _place_on_path(obstacle, path_points, candidate) if obstacle.kind == PATH else 0
                gap = math.hypot(candidate[0] - starts[i].x, candidate[1] - starts[i].y) - radius
                has_room = gap > _START_MARGIN
                if has_room and obstacle.kind != PATH:
                    has_room = clearance_at(candidate[0], candidate[1], spatial_index, int(starts[i].world)) > radius
                    for j in range(k):
                        other = obstacles[i, j]
                        if other.kind != EMPTY:
                            dx, dy = candidate[0] - other.x, candidate[1] - other.y
                            has_room = has_room and outlines.distance_to_outline(dx, dy, other) > radius
                if has_room or gap > largest_gap:
                    largest_gap, best, best_next_point = gap, candidate, next_point
                if has_room:
                    break
            obstacle.x, obstacle.y, obstacle.next = best[0], best[1], best_next_point
            obstacle.cos, obstacle.sin = math.cos(best[2]), math.sin(best[2])


@njit(cache=True)
def _place_on_path(obstacle, path_points, candidate):
    """Set `candidate[:3]` to the pose at the share `candidate[3]` of a path; return the number of the next point."""
    first, count = int(obstacle.first), int(obstacle.count)
    path_length = 0.0
    for measuring in (True, False):
        remaining = candidate[3] * path_length
        for leg in range(count):
            ax, ay = path_points[first + leg]
            bx, by = path_points[first + (leg + 1) % count]
            leg_length = math.hypot(bx - ax, by - ay)
            if measuring:
                path_length += leg_length
            elif remaining < leg_length or leg == count - 1:
                share = remaining / max(leg_length, 1e-9)
                candidate[0], candidate[1] = ax + share * (bx - ax), ay + share * (by - ay)
                candidate[2] = math.atan2(by - ay, bx - ax)
                return (leg + 1) % count
            else:
                remaining -= leg_length
    return 0
