"""Compile all numba functions ahead of time, for a container image.

    python -m tb2rl.warm

The compiled code is cached in NUMBA_CACHE_DIR if this variable is set, else beside the installed files. The cache may
be read-only afterwards.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tb2rl.core.command import ArgumentParser, command


@command("warm")
def main(parser: ArgumentParser) -> None:
    """Compile everything."""
    parser.set_defaults(run="tb2rl.warm:run")


def run(options: argparse.Namespace) -> None:
    """Call every compiled function, by a short training, evaluation, film and plan."""
    from tb2rl.envs.make import make_env  # imported here, because these imports take seconds
    from tb2rl.runs.algorithm import make_baseline
    from tb2rl.runs.config import resolve
    from tb2rl.training.training import train
    from tb2rl.viz.film import FilmOptions, film
    from tb2rl.worlds import World

    worlds = {"task.world": {"generator": "mixed", "worlds": 5, "difficulty": 0.0}}
    short_training = {"train.n_envs": 2, "train.total_timesteps": 64, "train.eval_episodes": 1, "train.eval_steps": 2}
    with TemporaryDirectory() as folder:
        policy = train("qlearn", simulation="kinematic", folder=Path(folder, "run"), settings=worlds | short_training)
        for group in (None, {"people": 1, "boxes": 1}):
            film(policy, Path(folder, "film.gif"), settings={"dynamic_obstacles": group}, options=FilmOptions(steps=2))
    sensors = ["laser", "camera", "free_paths", "visited"]
    seen: dict[str, Any] = {"observe": sensors, "dynamic_obstacles": {"people": 1}, "filters": ["passive_safety"]}
    env = make_env("maze", "raw", simulation="kinematic", **seen)
    env.reset()
    env.step(0)
    for agent in ("pursuit", "dwa", "vfh"):
        config = resolve(agent, "navigate", settings={**worlds, "task.guide": "plan", "task.map": "online"})
        env = make_env(config.task, "raw", simulation="kinematic")
        env.step(make_baseline(config).predict(env.reset()[0])[0])
    posts = [(x / 10, 1.0, 0.01) for x in range(200)]  # enough posts for a spatial index with a grid
    World.from_shapes("posts", posts=posts, start=(0.0, 0.0, 0.0)).clearance(0.0, 0.0)
    print("compiled; later starts load the compiled code")


if __name__ == "__main__":
    main()
