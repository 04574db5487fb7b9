"""Compile all numba functions ahead of time, for a container image.

    python -m tb2rl.warm

The compiled code is written to NUMBA_CACHE_DIR if that is set, else beside the installed files. Both are read later
even if they are read-only then.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from tb2rl.core.errors import ArgumentParser, command


@command
def main(arguments: list[str] | None = None) -> None:
    """Call every compiled function: train in the kinematic simulator, evaluate, film, plan."""
    ArgumentParser(prog="python -m tb2rl.warm", description=(__doc__ or "").splitlines()[0]).parse_args(arguments)
    from tb2rl.envs.make import make_env  # imported late: they take seconds
    from tb2rl.runs.algorithm import make_baseline
    from tb2rl.runs.layers import resolve
    from tb2rl.training.training import train
    from tb2rl.viz.episodes import FilmOptions
    from tb2rl.viz.film import film
    from tb2rl.worlds import World

    worlds = {"task.world": {"generator": "mixed", "worlds": 5, "difficulty": 0.0}}
    short = {"train.n_envs": 2, "train.total_timesteps": 64, "train.eval_episodes": 1, "train.eval_steps": 2}
    with TemporaryDirectory() as folder:
        policy = train("qlearn", simulation="kinematic", folder=Path(folder, "run"), settings=worlds | short)
        for dynamic_obstacles in (None, {"people": 1, "boxes": 1}):
            settings = {"dynamic_obstacles": dynamic_obstacles}
            film(policy, Path(folder, "film.gif"), settings=settings, options=FilmOptions(steps=2))
    sensors = ["laser", "camera", "free_paths", "visited"]
    env = make_env("maze", "raw", simulation="kinematic", observe=sensors, dynamic_obstacles={"people": 1})
    env.reset()
    env.step(0)
    for agent in ("pursuit", "dwa", "vfh"):
        config = resolve(agent, "navigate", settings={**worlds, "task.guide": "plan", "task.map": "online"})
        env = make_env(config.task, "raw", simulation="kinematic")
        action, _ = make_baseline(config).predict(env.reset()[0])
        env.step(action)
    posts = [(x / 10, 1.0, 0.01) for x in range(200)]  # enough for the laser to use its grid
    World.from_shapes("posts", posts=posts, start=(0.0, 0.0, 0.0)).clearance(0.0, 0.0)
    print("compiled; later starts load the compiled code")


if __name__ == "__main__":
    main()
