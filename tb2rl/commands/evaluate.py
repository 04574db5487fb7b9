"""The command `evaluate`: a standard or other evaluation, see `tb2rl.evaluate`."""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.commands.output import check_output, write_json
from tb2rl.commands.policy import chosen_policy, chosen_time_limit
from tb2rl.commands.robot import chosen_robot, robot_chosen
from tb2rl.core.compiled import announce_compiling
from tb2rl.core.errors import InputError
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.evaluator import EPISODES, SEED, STEPS
from tb2rl.evaluation.moments import LARGEST_SEED
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run
from tb2rl.simulation import default_simulator
from tb2rl.viz.table import print_evaluation

_MOST_EPISODES = 100_000  # as of train.eval_episodes


def run(options: argparse.Namespace) -> None:
    """Evaluate a policy, print a table, write JSON."""
    announce_compiling()
    robot = chosen_robot(options)
    options.steps = chosen_time_limit(options, STEPS)
    if options.episodes is None:
        options.episodes = EPISODES if robot is None else 1
    if options.seed is None:
        options.seed = SEED
    check(options)
    policy, config = chosen_policy(options)
    conditions = {name: getattr(options, name) for name in ("episodes", "steps", "seed")}
    conditions |= {} if robot else {"workers": options.workers}
    evaluation = evaluate(policy, config, progress=True, simulation=robot or options.simulation, **conditions)
    name = options.agent or options.policy
    print_evaluation(evaluation, f"{name} in {evaluation.scene.place if robot is None else 'a world with ROS'}")
    _write(evaluation, config, name, options)


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` if options contradict each other or are out of range."""
    check_shared(options)
    if options.on is not None:
        raise InputError("--on goes with --suite: the episodes are over before Ray has started")
    if robot_chosen(options) and options.workers is not None:
        raise InputError("--workers share simulated episodes among them; there is one robot with ROS")
    if options.goal is not None and not robot_chosen(options):
        raise InputError("--goal goes with --simulation ros; in a simulator use --set task.goal=[3,2]")
    if not 1 <= options.episodes <= _MOST_EPISODES or options.steps < 1 or not 0 <= options.seed <= LARGEST_SEED:
        counts = f"--episodes must be from 1 to {_MOST_EPISODES}, --steps at least 1"
        raise InputError(f"{counts}, and --seed from 0 to {LARGEST_SEED}")


def check_shared(options: argparse.Namespace) -> None:
    """Raise an `InputError` for the options of every evaluation: policy, processes, result file."""
    if (options.policy is None) == (options.agent is None):
        raise InputError("name a policy (a run folder, a checkpoint, zoo:NAME, hf:USER/REPOSITORY) or an --agent")
    if options.policy and options.task:
        raise InputError("--task goes with --agent; a policy keeps the task of its training")
    if options.workers is not None and options.workers < 1:
        raise InputError("--workers must be at least 1")
    check_output(options.json)


def _write(evaluation: Evaluation, config: Config, name: str, options: argparse.Namespace) -> None:
    """Write the evaluation to `--json`, or the standard evaluation of a run into its folder."""
    standard = (options.episodes, options.steps, options.seed) == (EPISODES, STEPS, SEED) and not options.set
    standard = standard and evaluation.simulation == default_simulator().name
    tree, arrays = evaluation.tree(config, name)
    if options.json:
        write_json(options.json, tree)
    elif options.policy and standard and Path(options.policy).is_dir():
        Run.open(Path(options.policy), options.trust).write_evaluation(tree, arrays)
    else:
        print("not written: a run folder keeps its standard evaluation only; --json FILE writes any evaluation")
