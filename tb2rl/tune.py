"""Search for better settings (hyperparameters) with Optuna.

    python -m tb2rl.tune --agent qlearn --task maze --trials 30
    python -m tb2rl.tune --agent ppo --preset mine.yaml --space my_space.yaml --minutes 60
    python -m tb2rl.tune --agent ppo --task navigate --set task.guide=plan --steps 2000000 --name with-plan
    python -m tb2rl.tune --agent ppo --task navigate --trials 1000 --on ray:10.0.0.1:6379

Trials are evaluated in the kinematic simulator, the best of them also in physics. The study is the folder
runs/tune/NAME. The same command continues a study, also in several terminals at once. Results are best.yaml, a preset
for `train --preset`, and report.html.
"""

from tb2rl.commands.arguments import add_simulation
from tb2rl.core.command import ArgumentParser, between, command
from tb2rl.core.plugins import agent_names, task_names
from tb2rl.execution.arguments import add_executor_arguments


@command("tune")
def main(parser: ArgumentParser) -> None:
    """Run trials, evaluate the best ones, write a preset and a page."""
    add = parser.add_argument
    add("--agent", help=f"{', '.join(agent_names())}, or module:Class (default: qlearn)")
    add("--task", help=f"{', '.join(task_names())}, or module:Class (default: maze)")
    add("--preset", help="initial settings of the search: a file in configs/, or a path")
    add("--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="fixed settings")
    add("--space", metavar="FILE", help="the search space (default: configs/tuning/AGENT.yaml)")
    add("--trials", type=between(1, 100_000), default=30, help="total number of trials of the study (default: 30)")
    add("--minutes", type=between(1e-3, 1e6, float), help="time limit; running trials are discarded")
    add("--seeds", type=between(1, 100), default=2, help="trainings of a trial, with different seeds (default: 2)")
    add("--steps", type=int, help="control steps of a training, over all environments")
    add_simulation(parser, "simulator of the trainings: ", default="kinematic")
    add("--sampler", default="tpe", help="Optuna's sampler: tpe (default) or random")
    add("--pruner", default="median", help="Optuna's pruner: median (default), hyperband or none")
    add("--seed", type=int, default=0, help="seed of the sampler (default: 0)")
    add_executor_arguments(parser)
    add("--fresh", type=between(0, 1000), default=3, help="number of new seeds to compare best with default; 0: none")
    add("--name", help="name of the folder runs/tune/NAME (default: TASK-AGENT)")
    add("--storage", metavar="URL", help="URL of a database (default: SQLite in the folder)")


if __name__ == "__main__":
    main()
