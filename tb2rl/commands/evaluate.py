"""Implementation of `python -m tb2rl.evaluate`: evaluates a policy in episodes or on a suite.

The functions `chosen_...` load what the arguments of `arguments.py` select, also for other commands.
"""

import argparse
import signal
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tb2rl.commands.arguments import refuse
from tb2rl.core import InputError, check_output, write_json
from tb2rl.core.compiled import announce_compiling
from tb2rl.core.values import Point, build, checked
from tb2rl.deploy.portable.termination import termination_signals
from tb2rl.deploy.ros.robot import RosRobot, parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, parse_topics
from tb2rl.evaluation.episodes import Policy, check_spaces
from tb2rl.evaluation.evaluate import EPISODES, SEED, STEPS, evaluate, time_limit
from tb2rl.evaluation.progress import progress
from tb2rl.evaluation.sim_to_sim import ALL, BY_SIMULATION, SimToSim, available_physics, describe_unavailable_physics
from tb2rl.evaluation.suite_comparison import results_in_json
from tb2rl.evaluation.suites import SuiteEpisode, run_suite, suite_evaluator, suite_result, suite_scene
from tb2rl.execution.arguments import make_executor
from tb2rl.runs import Config, config_of, load, make_baseline, parse_settings, policy_digest, resolve
from tb2rl.runs.folder import Journal, Run, versions
from tb2rl.simulation.simulator import default_simulator, find_simulator
from tb2rl.viz.table import print_evaluation, print_sim_to_sim, print_suite
from tb2rl.worlds.suites import Suite, find_suite


def run(options: argparse.Namespace) -> None:
    """Evaluate a policy, print a table, write JSON."""
    announce_compiling()
    if options.json:
        check_output(options.json)
    if options.suite:
        _evaluate_suite(options)
    else:
        _evaluate(options)


def _evaluate(options: argparse.Namespace) -> None:
    refuse(options, "needs --suite; an evaluation without a suite is too short for Ray", "on")
    robot = chosen_robot(options)
    if robot:
        refuse(options, "is for simulations; with ROS there is one robot", "workers")
    else:
        refuse(options, "needs --simulation ros; in a simulator use --set task.goal=[3,2]", "goal")
    names = [name for name in ("episodes", "seed", "workers") if getattr(options, name) is not None]
    conditions = {name: getattr(options, name) for name in names} | {"steps": chosen_time_limit(options, STEPS)}
    policy, config = chosen_policy(options)
    simulations = [robot] if robot else _chosen_simulations(options)
    evaluations = [evaluate(policy, config, progress_bar=True, simulation=each, **conditions) for each in simulations]
    evaluation, name = evaluations[0], options.agent or options.policy
    title = f"{name} in {'a world with ROS' if robot else evaluation.scene.worlds_title}"
    standard = EPISODES, STEPS, SEED, default_simulator().name
    is_standard = (len(evaluation.episodes), evaluation.steps, evaluation.seed, evaluation.simulation) == standard
    tree, arrays = evaluation.serialize(config, name)
    if len(evaluations) == 1:
        print_evaluation(evaluation, title)
    else:
        comparison = SimToSim.of(evaluations)
        print_sim_to_sim(comparison, title)
        tree[BY_SIMULATION] = comparison.to_json()
    if options.json:
        write_json(options.json, tree)
    elif is_standard and (run_folder := _run_for_result(options)):
        run_folder.write_evaluation(tree, arrays)
    else:
        print("not written: only a run folder's standard evaluation without --set is kept; --json FILE writes any")


def _chosen_simulations(options: argparse.Namespace) -> list[str | None]:
    """The simulators that `--simulation` selects; None: the default one. Also prints which ones `all` leaves out."""
    if options.simulation != ALL:
        return [options.simulation]
    simulations: list[str | None] = [simulator.name for simulator in available_physics(f"--simulation {ALL}")]
    missing = describe_unavailable_physics()
    if missing:
        print(f"not in all physics simulators: {missing}", flush=True)
    elif len(simulations) == 1:
        print("not compared: there is no second physics simulator", flush=True)
    return simulations


def _run_for_result(options: argparse.Namespace) -> Run | None:
    """The run folder to write the result to; None if the policy is not a folder, or with `--set`."""
    if options.set or not options.policy or not Path(options.policy).is_dir():
        return None
    return Run.open(Path(options.policy), options.trust)


def _evaluate_suite(options: argparse.Namespace) -> None:
    if chosen_robot(options):
        raise InputError(f"--suite needs a simulator, but --simulation {options.simulation} is a robot")
    fixed_options = ("episodes", "steps", "seed", "goal")
    refuse(options, "cannot be combined with --suite, which defines its episodes", *fixed_options)
    if "task.episode_steps" in parse_settings(options.set):
        raise InputError("task.episode_steps cannot be combined with --suite, because each suite has a time limit")
    if len(options.suite) > 2:
        raise InputError("--suite takes a name, and a path for barn; put the policy before --suite")
    name, *path = options.suite
    suite = find_suite(name, Path(*path) if path else None)
    policy, config = chosen_policy(options)
    scene = suite_scene(config.scene, suite)
    check_spaces(policy, scene)
    digest = policy_digest(options.policy, options.trust) if options.agent is None else None
    origin: dict[str, Any] = {"policy": options.policy or f"agent {options.agent}", "policy_digest": digest}
    is_kept = options.simulation in (None, ALL, default_simulator().name) and not options.json
    run_folder = _run_for_result(options) if is_kept else None
    file = run_folder.suite_file(suite.name) if run_folder else options.json
    if file is None:
        kept = "a run folder's result without --set, in the default simulator or in all, is kept"
        print(f"not written: only {kept}; --json FILE writes any")
    executor, results, journals = make_executor(options) if options.on else None, [], []
    with executor or nullcontext():
        for simulation in _chosen_simulations(options):
            with suite_evaluator(scene, 1 if executor else options.workers, simulation) as evaluator:
                origin["simulation"] = evaluator.simulator.name
                journals.append(_journal(file, suite, config, origin))
                episodes = _finished_episodes(journals[-1], len(suite.worlds))
                new_episodes = run_suite(evaluator, policy, suite, len(episodes), executor)
                for episode in progress(new_episodes, "evaluating", "world", total=len(suite.worlds) - len(episodes)):
                    journals[-1].append(asdict(episode))
                    episodes.append(episode)
                results.append(suite_result(suite, scene, episodes, config, **origin))
    if file is not None:
        write_json(file, results_in_json(results))
    for journal in journals:
        journal.remove()
    print_suite(*results)


def _journal(file: Path | None, suite: Suite, config: Config, origin: dict[str, Any]) -> Journal:
    """The journal, a file beside the result that holds the finished episodes of an interrupted suite."""
    simulation = origin["simulation"].replace(":", ".")  # "module:Class", which Windows allows in no name of a file
    path = None if file is None else file.with_name(f"{file.name}.{simulation}.journal")
    rules = {"name": suite.name, "digest": suite.digest, "time": suite.time_limit, "goal_radius": suite.goal_radius}
    return Journal(path, {**origin, "suite": rules, "config": config.to_dict(), "versions": versions()})


def _finished_episodes(journal: Journal, num_worlds: int) -> list[SuiteEpisode]:
    """The episodes in a journal; also prints whether the suite continues."""
    episodes = [build(SuiteEpisode, entry, str(journal.path)) for entry in journal.entries]
    if journal.mismatch is not None:
        print(f"starting again, because {journal.path} is from another {journal.mismatch}")
    elif episodes:
        print(f"continuing: {len(episodes)} of {num_worlds} worlds are in {journal.path}")
    return episodes


def chosen_policy(options: argparse.Namespace) -> tuple[Policy, Config]:
    """Load the chosen policy, and the config of the task at which it drives.

    Raises:
        InputError: If the policy does not exist, or a setting is invalid.
    """
    if (options.policy is None) == (options.agent is None):
        raise InputError("name a policy: run folder, checkpoint, zoo:NAME, hf:USER/REPOSITORY, or non-learning --agent")
    settings = parse_settings(options.set)
    if options.agent is not None:
        config = with_safety(resolve(options.agent, options.task, settings=settings), options.safe)
        return make_baseline(config), config
    refuse(options, "needs --agent; for a policy, --set task.KEY=VALUE changes the task of its training", "task")
    policy = load(options.policy, options.trust)
    for key in settings:
        if not key.startswith("task."):
            raise InputError(f"of a trained policy, only the task can be set (task.KEY=VALUE), got {key!r}")
    config = config_of(policy).with_task({key.removeprefix("task."): value for key, value in settings.items()})
    return policy, with_safety(config, options.safe)


def with_safety(config: Config, setting: str | None) -> Config:
    """Put the safety filter before the task's filters; `setting` is the value of `--safe`, or None."""
    if setting is None:
        return config
    return config.with_task({"filters": [{"safety": {"setting": setting}}, *config.task.filters]})


def chosen_time_limit(options: argparse.Namespace, default: int) -> int:
    """Time limit of an episode [control steps], from `--steps` or `--set task.episode_steps`."""
    settings = parse_settings(options.set)
    return time_limit(options.steps, {key.removeprefix("task."): value for key, value in settings.items()}, default)


def parse_goal(text: str) -> Point:
    """Parse a goal x, y [m], such as "3,2"."""
    return checked(Point, text.split(","), "--goal")


def chosen_robot(options: argparse.Namespace) -> RosRobot | None:
    """The robot with ROS that the arguments select; None for a simulation.

    With a robot, all termination signals raise `KeyboardInterrupt` from now on, so that `close` can stop the robot.
    """
    if options.simulation in (None, ALL) or not find_simulator(options.simulation).is_external:
        refuse(options, "needs --simulation ros", "ros", "topics", "mounting", "top_speed", "ros_args")
        return None
    ros = options.ros or 1
    topics = asdict(parse_topics(options.topics, TURTLEBOT2[ros]))
    mounting, limits = parse_mounting(options.mounting or "0,0,0"), parse_limits(options.top_speed, "--top-speed")
    goal = None if options.goal is None else parse_goal(options.goal)
    for number in termination_signals():
        signal.signal(number, signal.default_int_handler)
    return RosRobot(ros, topics, mounting, limits, goal, tuple(options.ros_args))
