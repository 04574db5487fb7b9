"""Replays: recorded episodes as JSON values, which `replay.js` draws in 3D."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import EpisodeStep, check_spaces
from tb2rl.evaluation.evaluate import Evaluator, random_initial_states
from tb2rl.simulation.obstacles.outlines import COS, LENGTH, SIN, WIDTH, X, Y
from tb2rl.simulation.simulator import SimulatorType, batch_simulator, default_simulator
from tb2rl.viz.cameras import exact_ranges, goal_of
from tb2rl.viz.run_views import RunView
from tb2rl.worlds import World
from tb2rl.worlds.world import box_polygons

RUN_EPISODES, RUN_STEPS = 3, 300  # number of replays of a run, and their maximum length [control steps]
_MAX_STATES, _MAX_BEAMS = 400, 36  # of a replay


def make_replay(steps: Sequence[EpisodeStep], scene: Scene) -> dict[str, Any]:
    """The values of an episode for `replay.js`; of a long episode, only every n-th state.

    Lengths and angles are integers in mm and mrad, but "ranges" in cm. "walls" are polygons, each a list of rings of
    x, y. "times" [s], "poses", "ranges" and "obstacles" (x, y, yaw of the dynamic ones) have a row for each state.
    "shapes" are half length and half width, or radius and 0, of the dynamic obstacles. "rows" are v, w, reward, return,
    and indices in "texts" of action and filter's reason, for the steps that lead to the second and later states.
    """
    stride = math.ceil(len(steps) / _MAX_STATES)
    kept, control_period = [*steps[stride - 1 : -1 : stride], steps[-1]], scene.task.control_period
    states, initial_state = [steps[0].before, *(step.after for step in kept)], steps[0].after.initial_state
    world, goal = scene.spec.worlds[int(initial_state.world[0])], goal_of(scene.task, initial_state)
    poses, tables = np.array([state.pose[0] for state in states]), [state.dynamic_obstacles for state in states]
    outlines = np.array([np.empty((0, 6)) if table is None else table[0] for table in tables])
    outlines = outlines[:, outlines[0, :, LENGTH] > 0.0]  # without empty rows
    yaws, beams = np.arctan2(outlines[..., SIN], outlines[..., COS]), len(scene.laser.angles)
    angles = scene.laser.angles[np.linspace(0, beams - 1, min(beams, _MAX_BEAMS)).round().astype(int)]
    described = [(scene.actions.describe(step.action), step.intervention) for step in kept]
    texts = list(dict.fromkeys(text for pair in described for text in pair))
    numbers = [(*step.after.twist[0].tolist(), step.reward, step.episode_return) for step in kept]
    return {
        "bounds": _thousandths(world.bounds),
        "walls": _walls(world),
        "posts": _thousandths(world.posts),
        "goal": _thousandths(goal) if np.isfinite(goal).all() else None,
        "radius": _thousandths(scene.robot.radius),
        "angles": _thousandths(angles),
        "times": [0.0, *(round(step.number * control_period, 3) for step in kept)],
        "poses": _thousandths(poses),
        "ranges": _thousandths(np.minimum(exact_ranges(poses, angles, world, outlines), scene.laser.max_range) / 10),
        "shapes": _thousandths(outlines[0][:, [LENGTH, WIDTH]]),
        "obstacles": _thousandths(np.dstack([outlines[..., X], outlines[..., Y], yaws])),
        "texts": texts,
        "rows": [
            [*(round(number, 3) for number in row), *map(texts.index, pair)]
            for row, pair in zip(numbers, described, strict=True)
        ],
        "ended": steps[-1].info["ended"],
        "failed": bool(steps[-1].info["failed"]),
    }


def run_replays(view: RunView) -> dict[str, Any]:
    """The "view", "replays" of the first steps of its first evaluation episodes, their "simulator", or an "error".

    The kinematic simulator drives if it has the task's sensors, so the replays may differ from the evaluation.
    """
    for simulator in (batch_simulator(), default_simulator()):
        try:
            return {"view": view, "replays": _repeat(view, simulator), "simulator": simulator.name, "error": ""}
        except InputError as error:
            reason = str(error)
    return {"view": view, "replays": [], "simulator": "", "error": reason}


def _repeat(view: RunView, simulator: SimulatorType) -> list[dict[str, Any]]:
    scene, seed, limit = view.evaluation.scene, view.evaluation.seed, view.evaluation.steps
    states = random_initial_states(scene, RUN_EPISODES, seed)
    with Evaluator(scene, states, min(RUN_STEPS, limit), seed, workers=1, simulation=simulator) as evaluator:
        check_spaces(view.policy, evaluator.scene)
        replays = [make_replay(evaluator.replay(view.policy, i), evaluator.scene) for i in range(RUN_EPISODES)]
    is_cut = {"time limit"} if limit > RUN_STEPS else set()
    return [{**replay, "ended": "" if replay["ended"] in is_cut else replay["ended"]} for replay in replays]


def _walls(world: World) -> list[list[list[list[int]]]]:
    """The union of the boxes, because inner faces would be drawn; walls lie to the left of each ring."""
    union = shapely.union_all(box_polygons(world.boxes)).simplify(0.01)  # [m]; worlds from maps have many corners
    polygons = shapely.orient_polygons(shapely.get_parts(union))
    return [[_thousandths(ring.coords[:-1]) for ring in (each.exterior, *each.interiors)] for each in polygons]


def _thousandths(values: Any) -> Any:
    """Values times 1000, as nested lists of integers."""
    return np.round(1000 * np.asarray(values)).astype(int).tolist()
