"""Search for better settings with Optuna.

    python -m tb2rl.tune --agent qlearn --task maze --trials 30
    python -m tb2rl.tune --agent ppo --preset mine.yaml --space my_space.yaml --minutes 60
    python -m tb2rl.tune --agent ppo --task navigate --set task.guide=plan --steps 2000000 --name with-plan
    python -m tb2rl.tune --agent ppo --task navigate --trials 1000 --on ray:10.0.0.1:6379

Trials drive in the kinematic simulator, the best of them in PyBullet. The study is the folder runs/tune/NAME. The same
command continues it, also in several terminals at once. Results: best.yaml, for `train --preset`, and report.html.
"""

from __future__ import annotations

import argparse

from tb2rl.core.errors import ArgumentParser, InputError, command, install_extra
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.execution.arguments import add_executor_arguments


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.tune", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--agent", help=f"{', '.join(agent_names())}, or module:Class (default: qlearn)")
    parser.add_argument("--task", help=f"{', '.join(task_names())}, or module:Class (default: maze)")
    parser.add_argument("--preset", help="where the search begins: a file of configs, or a path")
    parser.add_argument(
        "--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="settings that are fixed"
    )
    parser.add_argument("--space", metavar="FILE", help="the search space (default: configs/tuning/AGENT.yaml)")
    parser.add_argument("--trials", type=int, default=30, help="trials of the whole study (default: 30)")
    parser.add_argument("--minutes", type=float, help="time limit of the trials; running ones are dropped")
    parser.add_argument("--seeds", type=int, default=2, help="trainings of a trial (default: 2)")
    parser.add_argument("--steps", type=int, help="control steps of a training, over all environments")
    parser.add_argument(
        "--simulation", default="kinematic", help="simulator of the trainings: kinematic (default) or bullet"
    )
    parser.add_argument("--sampler", default="tpe", help="Optuna's sampler: tpe (default) or random")
    parser.add_argument("--pruner", default="median", help="Optuna's pruner: median (default), hyperband or none")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sampler (default: 0)")
    add_executor_arguments(parser)
    parser.add_argument(
        "--fresh", type=int, default=3, help="seeds of the comparison of best and default settings; 0: none"
    )
    parser.add_argument("--name", help="name of the folder runs/tune/NAME (default: TASK-AGENT)")
    parser.add_argument("--storage", metavar="URL", help="URL of a database (default: SQLite in the folder)")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Run trials, evaluate the best ones, write a preset and a page."""
    options = parse(arguments)
    try:
        from tb2rl.commands.tune import run  # only now: it imports what takes seconds
    except ModuleNotFoundError as error:
        if error.name != "optuna":
            raise
        raise InputError(f"tune needs Optuna: {install_extra('tune')}") from None
    run(options)


if __name__ == "__main__":
    main()
