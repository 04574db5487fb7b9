"""The standard evaluation: a greedy policy in PyBullet's physics, from start poses that training did not draw.

    python -m tb2rl.evaluate runs/maze/dqn/NAME
    python -m tb2rl.evaluate --agent wallfollower

100 episodes of at most 1 500 control steps, each with a start pose and a random stream of its own: the result does not
depend on how many processes share the work. It takes half a minute on two processors.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tb2rl.errors import ArgumentParser, InputError, command
from tb2rl.files import write_text
from tb2rl.judging.evaluation import Evaluation
from tb2rl.judging.evaluator import EPISODES, SEED, STEPS, evaluate
from tb2rl.judging.rollout import LARGEST_SEED
from tb2rl.policy_arguments import add_policy_arguments, chosen_policy
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run
from tb2rl.showing.table import print_evaluation


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.evaluate", description=(__doc__ or "").splitlines()[0])
    add_policy_arguments(parser)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--steps", type=int, default=STEPS, help="control steps at most in an episode")
    parser.add_argument("--seed", type=int, default=SEED, help="of the start poses")
    parser.add_argument("--workers", type=int, help="processes (default: one for each processor)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result here, not into the run folder")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Evaluate a policy, print a table, write JSON."""
    options = parse(arguments)
    check(options)
    policy, config = chosen_policy(options)
    conditions = {name: getattr(options, name) for name in ("episodes", "steps", "seed", "workers")}
    evaluation = evaluate(policy, config, progress=True, **conditions)
    name = options.agent or options.policy
    print_evaluation(evaluation, f"{name} in {evaluation.task.world}")
    _write(evaluation, config, name, options)


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` where options do not go together, or do not fit."""
    if (options.policy is None) == (options.agent is None):
        raise InputError("name either a policy (a run folder, a checkpoint, zoo:NAME) or an --agent")
    if options.policy and options.task:
        raise InputError("--task goes with --agent; a policy keeps the task that it was trained at")
    workers = 1 if options.workers is None else options.workers
    if min(options.episodes, options.steps, workers) < 1 or not 0 <= options.seed <= LARGEST_SEED:
        raise InputError(f"--episodes, --steps and --workers must be at least 1, and --seed from 0 to {LARGEST_SEED}")
    if options.json and not options.json.absolute().parent.is_dir():
        raise InputError(f"cannot write {options.json}: there is no folder {options.json.absolute().parent}")


def _write(evaluation: Evaluation, config: Config, name: str, options: argparse.Namespace) -> None:
    """Put the evaluation into the file that is named, or the standard one into its run folder."""
    standard = (options.episodes, options.steps, options.seed) == (EPISODES, STEPS, SEED) and not options.set
    tree, arrays = evaluation.tree(config, name)
    if options.json:
        try:
            write_text(options.json, json.dumps(tree, indent=1) + "\n")
        except OSError as error:
            raise InputError(f"cannot write {options.json}: {error.strerror}") from None
    elif options.policy and standard and Path(options.policy).is_dir():
        Run.open(Path(options.policy)).write_evaluation(tree, arrays)
    else:
        print("not written: only the standard evaluation of a run folder is kept there; --json FILE keeps any")


if __name__ == "__main__":
    main()
