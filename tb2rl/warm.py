"""Compile all that gets compiled ahead, for the image of a container.

    python -m tb2rl.warm

Where the compiled code lies: in NUMBA_CACHE_DIR if that is set, else beside the installed files. Both are used later,
though they cannot be written then.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tb2rl.core.errors import ArgumentParser, command


@command
def main(arguments: list[str] | None = None) -> None:
    """Do a little of all that needs compiled code: train in the twin, evaluate, film."""
    ArgumentParser(prog="python -m tb2rl.warm", description=(__doc__ or "").splitlines()[0]).parse_args(arguments)
    from tb2rl.envs.make import make_env  # only now: it imports what takes seconds
    from tb2rl.runs.algorithm import make_baseline
    from tb2rl.runs.layers import resolve
    from tb2rl.training.training import train
    from tb2rl.viz.film import film
    from tb2rl.worlds import World

    with TemporaryDirectory() as folder:
        worlds = {"task.world": {"generator": "mixed", "worlds": 5, "difficulty": 0.0}}
        short: dict[str, Any] = {
            "settings": worlds,
            "n_envs": 2,
            "total_timesteps": 64,
            "eval_episodes": 1,
            "eval_steps": 2,
        }
        policy = train("qlearn", simulation="kinematic", folder=Path(folder, "run"), **short)
        for dynamic_obstacles in (None, {"people": 1, "boxes": 1}):
            film(policy, Path(folder, "film.gif"), settings={"dynamic_obstacles": dynamic_obstacles}, steps=2)
    sensors = ["laser", "camera", "free_paths", "visited"]
    env = make_env("maze", "raw", simulation="kinematic", observe=sensors, dynamic_obstacles={"people": 1})
    env.reset()
    env.step(0)
    for agent in ("pursuit", "dwa", "vfh"):
        config = resolve(agent, "navigate", settings={**worlds, "task.guide": "plan", "task.map": "online"})
        env = make_env(config.task, "raw", simulation="kinematic")
        action, _ = make_baseline(config).predict(env.reset()[0])
        env.step(action)
    posts = [(x / 10, 1.0, 0.01) for x in range(200)]  # enough to need a grid
    World.from_shapes("posts", posts=posts, start=(0.0, 0.0, 0.0)).clearance(0.0, 0.0)
    print("compiled; what comes next starts without")


if __name__ == "__main__":
    main()
