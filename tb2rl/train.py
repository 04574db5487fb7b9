"""Train an agent at a task, and leave a run folder.

    python -m tb2rl.train --agent qlearn
    python -m tb2rl.train --agent dqn --set task.world=circuit agent.gamma=0.97 --name mine
    python -m tb2rl.train --agent ppo --simulation kinematic --seeds 0..4
    python -m tb2rl.train --agent ppo --simulation kinematic --seeds 0..31 --on ray:10.0.0.1:6379
    python -m tb2rl.train --resume runs/maze/dqn/mine

Several seeds are trained in parallel, one thread each: by processes, or by Ray with `--on ray`, here or on a cluster.
Everything has a default, in a signature or a preset of `configs`; `--set` changes anything.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.execution.arguments import add_executor_arguments


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = ArgumentParser(prog="python -m tb2rl.train", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--agent", help=f"{', '.join(agent_names())}, or module:Class (default: qlearn)")
    parser.add_argument("--task", help=f"{', '.join(task_names())}, or module:Class (default: maze)")
    parser.add_argument("--preset", help="a file of configs, such as tutorial, or a path")
    parser.add_argument(
        "--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="e.g. agent.gamma=0.9"
    )
    parser.add_argument("--name", help="of the run folder runs/TASK/AGENT/NAME (default: date and time)")
    parser.add_argument("--total-timesteps", type=int, help="control steps, over all environments")
    parser.add_argument("--episodes", type=int, help="stop after so many, if that comes before --total-timesteps")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--seeds", metavar="A..B", help="train once with each of these seeds, and print a summary")
    add_executor_arguments(parser)
    parser.add_argument("--simulation", help="simulator to train in: bullet (default) or kinematic")
    parser.add_argument("--n-envs", type=int, help="environments, in parallel processes or in one batch")
    parser.add_argument("--device", help="of the networks: cpu, cuda, auto")
    parser.add_argument("--eval-freq", type=int, help="control steps between evaluations; 0: no evaluations")
    parser.add_argument("--save-freq", type=int, help="control steps between checkpoints; 0: only the last")
    parser.add_argument("--keep", type=int, help="checkpoints of the training to keep, the latest")
    parser.add_argument(
        "--track", nargs="+", action="extend", metavar="NAME", help="mlflow, wandb or module:Class: send figures there"
    )
    parser.add_argument("--resume", type=Path, metavar="FOLDER", help="continue a run; takes --total-timesteps")
    parser.add_argument("--no-evaluation", action="store_true", help="skip the standard evaluation at the end")
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="a line for each episode")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Train, print the result, evaluate."""
    options = parse(arguments)
    from tb2rl.commands.train import run  # only now: it imports what takes seconds

    run(options)


if __name__ == "__main__":
    main()
