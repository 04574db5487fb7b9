"""The dynamic obstacles of all environments; one number of an initial state decides everything that they do."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.obstacles.outlines import COS, OUTLINE, as_records, gap_to, outer_radius
from tb2rl.simulation.obstacles.records import EMPTY, FIELDS, OBSTACLE, PATH, PERSON, STRAIGHT, ObstacleArrays
from tb2rl.simulation.random_streams import StreamDraws
from tb2rl.simulation.spec import SimulationSpec
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles as Group
from tb2rl.worlds.geometry import clearance_at
from tb2rl.worlds.index import WorldIndex

_PLACES = 8  # drawn for each obstacle, which takes the first one with room
_ROOM = 1.5  # [m] between the robot and an obstacle at the start, if there is such a place
_CONSTANT = ["length", "width", "kind", "first", "count", "closed", "avoids", "min_speed", "max_speed"]
_ABSENT = np.eye(len(FIELDS))[COS]  # the row of an obstacle that is not there
_SEEDS = 2.0**53  # different numbers in [0, 1)


class DynamicObstacles:
    """The dynamic obstacles of all environments.

    Args:
        spec: The worlds and their dynamic obstacles.
        num_envs: Number of environments.

    Attributes:
        table: Rows of `tb2rl.simulation.obstacles.records.FIELDS`, shape (num_envs, obstacles, len(FIELDS)).
        streams: See `ObstacleArrays`.
    """

    def __init__(self, spec: SimulationSpec, num_envs: int) -> None:
        self._spec = spec
        self._kinds, self._path_points = _tables(spec)
        self._presence, self._leaders = _presence(spec, self._kinds.shape[1])
        self.table = np.zeros((num_envs, *self._kinds.shape[1:]))
        self.streams = np.zeros((num_envs, 2), dtype=np.uint64)

    @property
    def arrays(self) -> ObstacleArrays:
        """Views for compiled code."""
        return ObstacleArrays(as_records(self.table, OBSTACLE), self.streams, self._path_points)

    @property
    def outlines(self) -> np.ndarray:
        """See `RobotState.dynamic_obstacles`: a view of the table."""
        return self.table[:, :, OUTLINE]

    def reset_at(
        self, indices: np.ndarray, initial_state: InitialState, index: WorldIndex, world_of: np.ndarray
    ) -> None:
        """Place the obstacles of some environments for new episodes.

        Args:
            indices: Of these environments, shape (n,).
            initial_state: n rows.
            index: Of some worlds.
            world_of: The number of each one's world in `index`, shape (n,).
        """
        worlds, initial = initial_state.world.astype(int), initial_state.rows
        table, keys = self._kinds[worlds], (initial["obstacle_seed"] * _SEEDS).astype(np.uint64)
        obstacles, count = as_records(table, OBSTACLE), table.shape[1]
        draws = StreamDraws(keys, np.zeros(len(indices), dtype=np.uint64))
        numbers = draws.uniform(count * (_PLACES * 4 + 1)).reshape(len(indices), count, -1)
        speeds = obstacles["min_speed"], obstacles["max_speed"]
        obstacles["speed"] = speeds[0] + numbers[:, :, -1] * (speeds[1] - speeds[0])
        places = numbers[:, :, :-1].reshape(len(indices), count, _PLACES, 4)
        if (obstacles["kind"] > PATH).any():
            each = np.repeat(worlds, count * _PLACES)
            found = self._spec.poses_from(each, places.reshape(-1, 4), self._spec.robot.radius)
            places = np.concatenate([found.reshape(*places.shape[:3], 3), places[..., :1]], axis=3)
        else:
            places = places[..., [1, 2, 3, 0]]
        if (self._presence < 1.0).any():
            drawn = np.take_along_axis(draws.uniform(count), self._leaders[worlds], axis=1)
            table[drawn >= self._presence[worlds]] = _ABSENT
        _place_all(obstacles, self._path_points, places, initial, index, world_of)
        self.table[indices], self.streams[indices, 0], self.streams[indices, 1] = table, keys, draws.counts

    def state(self) -> dict[str, np.ndarray]:
        """Everything that their future depends on."""
        return {"table": self.table.copy(), "streams": self.streams.copy()}

    def restore(self, state: Mapping[str, Any], initial_state: InitialState) -> None:
        """Continue from a `state`, in episodes with these initial states.

        Raises:
            ValueError: If these are other obstacles.
        """
        table, streams = np.array(state["table"], dtype=float), np.array(state["streams"], dtype=np.uint64)
        if table.shape != self.table.shape or streams.shape != self.streams.shape or not np.isfinite(table).all():
            raise ValueError("other dynamic obstacles: shape mismatch")
        worlds, now = initial_state.world.astype(int), as_records(table, OBSTACLE)
        kinds = as_records(self._kinds[worlds], OBSTACLE)
        absent = (table == _ABSENT).all(axis=2) & (self._presence[worlds] < 1.0)
        if not (np.all([now[name] == kinds[name] for name in _CONSTANT], axis=0) | absent).all():
            raise ValueError("other dynamic obstacles")
        known = (now["next"] >= 0) & (now["next"] < now["count"]) & (np.abs(now["stride"]) == 1)
        speed = (now["speed"] >= 0) & (now["speed"] <= kinds["max_speed"])
        if not ((known | (now["kind"] != PATH)) & speed).all():
            raise ValueError("a dynamic obstacle has an impossible speed or path")
        self.table, self.streams = table, streams


def make_dynamic_obstacles(spec: SimulationSpec, num_envs: int) -> DynamicObstacles | None:
    """The dynamic obstacles of a spec; None if no world has any."""
    return DynamicObstacles(spec, num_envs) if spec.has_dynamic_obstacles else None


def _tables(spec: SimulationSpec) -> tuple[np.ndarray, np.ndarray]:
    """The obstacles of each world before an episode, (worlds, obstacles, len(FIELDS)), and the points of all paths."""
    points: list[tuple[float, float]] = []
    common = [row for group in spec.dynamic_obstacles for row in _rows(group, points)]
    rows = [
        [*common, *(row for group in world.dynamic_obstacles for row in _rows(group, points))] for world in spec.worlds
    ]
    table = np.tile(_ABSENT, (len(rows), max(map(len, rows)), 1))
    for world, own in enumerate(rows):
        table[world, : len(own)] = np.reshape(own, (len(own), len(FIELDS)))
    return table, np.array(points).reshape(-1, 2)


def _presence(spec: SimulationSpec, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The probability that each obstacle is present, and whose random number decides: the first one's of its group.

    Returns:
        Probabilities and numbers of obstacles, shape (worlds, count) each.
    """
    presence = np.ones((len(spec.worlds), count))
    leaders = np.zeros((len(spec.worlds), count), dtype=int)
    for number in range(len(spec.worlds)):
        first = 0
        for group in spec.dynamic_obstacles_in(number):
            own = slice(first, first + group.count)
            presence[number, own], leaders[number, own], first = group.presence, first, own.stop
    return presence, leaders


def _rows(group: Group, points: list[tuple[float, float]]) -> list[np.ndarray]:
    """A row of the table for each obstacle of a group; the points of its path are added to `points`."""
    row = dict.fromkeys(FIELDS, 0.0) | {"cos": 1.0, "stride": 1.0}
    row["min_speed"], row["max_speed"] = group.speed
    if group.path is not None:
        row |= {"first": len(points), "count": len(group.path), "closed": float(group.closed)}
        points.extend(group.path)
    straight = STRAIGHT if group.path is None else PATH
    shapes = [(PERSON, group.radius, 0.0, float(group.avoid_robot))] * group.people
    shapes += [(straight, group.radius, 0.0, 0.0)] * group.posts
    shapes += [(straight, group.size[0] / 2, group.size[1] / 2, 0.0)] * group.boxes
    names = ("kind", "length", "width", "avoids")
    return [np.array(list((row | dict(zip(names, shape, strict=True))).values())) for shape in shapes]


@njit(cache=True)
def _place_all(obstacles, path_points, places, initial, index, world_of):
    """Put each obstacle at the first of its places with room, else at that farthest from the robot.

    `places` (num_envs, obstacles, n, 4) are x, y [m], heading [rad], and the share in [0, 1) of its path. An obstacle
    on a path can stand anywhere on it that is not near the robot.
    """
    for i in range(obstacles.shape[0]):
        for k in range(obstacles.shape[1]):
            obstacle = obstacles[i, k]
            if obstacle.kind == EMPTY:
                continue
            farthest, radius = -np.inf, outer_radius(obstacle)
            best, point, stride = places[i, k, 0], 0, 1.0
            for n in range(places.shape[2]):
                place = places[i, k, n].copy()
                if obstacle.kind == PATH:
                    next_point, direction = _place_on_path(obstacle, path_points, place)
                else:
                    next_point, direction = 0, 1.0
                gap = math.hypot(place[0] - initial[i].x, place[1] - initial[i].y) - radius
                fits = gap > _ROOM
                if fits and obstacle.kind != PATH:
                    fits = clearance_at(place[0], place[1], index, world_of[i]) > radius
                    for other in range(k):
                        if obstacles[i, other].kind != EMPTY:
                            east, north = place[0] - obstacles[i, other].x, place[1] - obstacles[i, other].y
                            fits = fits and gap_to(east, north, obstacles[i, other]) > radius
                if fits or gap > farthest:
                    farthest, best, point, stride = gap, place, next_point, direction
                if fits:
                    break
            obstacle.x, obstacle.y = best[0], best[1]
            obstacle.cos, obstacle.sin = math.cos(best[2]), math.sin(best[2])
            obstacle.next, obstacle.stride = point, stride


@njit(cache=True)
def _place_on_path(obstacle, path_points, place):
    """Write the pose at the share `place[3]` of an obstacle's path into `place`; return its next point and stride."""
    first, count = int(obstacle.first), int(obstacle.count)
    legs = count if obstacle.closed != 0.0 else 2 * count - 2  # there and back
    length = 0.0
    for measuring in (True, False):
        left = place[3] * length
        for leg in range(legs):
            here, there = leg, leg + 1
            if obstacle.closed != 0.0:
                there %= count
            elif leg >= count - 1:
                here, there = 2 * count - 2 - leg, 2 * count - 3 - leg
            ax, ay = path_points[first + here]
            bx, by = path_points[first + there]
            distance = math.hypot(bx - ax, by - ay)
            if measuring:
                length += distance
            elif left < distance or leg == legs - 1:
                share = left / max(distance, 1e-9)
                place[0], place[1] = ax + share * (bx - ax), ay + share * (by - ay)
                place[2] = math.atan2(by - ay, bx - ax)
                return there, 1.0 if there >= here or obstacle.closed != 0.0 else -1.0
            else:
                left -= distance
    return 0, 1.0
