"""Train an agent at a task, and write a run folder.

    python -m tb2rl.train --agent qlearn
    python -m tb2rl.train --agent dqn --set task.world=circuit agent.gamma=0.97 --name mine
    python -m tb2rl.train --agent ppo --simulation kinematic --seeds 0..4
    python -m tb2rl.train --agent ppo --simulation kinematic --seeds 0..31 --on ray:10.0.0.1:6379
    python -m tb2rl.train --agent dqn --viewer
    python -m tb2rl.train --resume runs/maze/dqn/mine

Several seeds are trained in parallel, with one thread each: in processes, or with `--on ray` by Ray on this machine or
a cluster. All settings have defaults, in the signatures of constructors and in the presets of `configs`. `--set`
changes any setting.
"""

from pathlib import Path

from tb2rl.commands.arguments import add_page_arguments, add_safe, add_simulation
from tb2rl.core.command import ArgumentParser, command
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.execution.arguments import add_executor_arguments


@command("train")
def main(parser: ArgumentParser) -> None:
    """Train, print the result, evaluate."""
    add = parser.add_argument
    add("--agent", help=f"{', '.join(agent_names())}, or module:Class (default: qlearn)")
    add("--task", help=f"{', '.join(task_names())}, or module:Class (default: maze)")
    add("--preset", help="a file in configs/, such as tutorial, or a path")
    add("--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="e.g. agent.gamma=0.9")
    add_safe(parser)
    add("--name", help="name of the run folder runs/TASK/AGENT/NAME (default: seed, settings, date and time)")
    add("--total-timesteps", type=int, help="control steps, over all environments")
    add("--episodes", type=int, help="stop after this number of episodes, or earlier at --total-timesteps")
    add("--seed", type=int, help="random seed")
    add("--seeds", metavar="A..B", help="train once with each of these seeds, and print a summary")
    add_executor_arguments(parser)
    add_simulation(parser, "simulator to train in: ")
    add("--n-envs", type=int, help="environments, in parallel processes or in one batch")
    add("--device", help="device of the networks: cpu, cuda, auto")
    add("--eval-freq", type=int, help="control steps between evaluations; 0: no evaluations")
    add("--save-freq", type=int, help="control steps between checkpoints; 0: only the last")
    add("--keep", type=int, help="number of checkpoints to keep, the latest ones")
    add("--track", nargs="+", action="extend", metavar="NAME", help="send metrics to mlflow, wandb or module:Class")
    add("--resume", type=Path, metavar="FOLDER", help="continue a run, optionally with a larger --total-timesteps")
    add("--no-evaluation", action="store_true", help="skip the standard evaluation at the end")
    add("--viewer", action="store_true", help="show the environments that train, on a page in the browser")
    add_page_arguments(parser)
    add("--no-progress", action="store_true", help="no progress bar")
    add("-v", "--verbose", action="count", default=0, help="print a line for each episode")


if __name__ == "__main__":
    main()
