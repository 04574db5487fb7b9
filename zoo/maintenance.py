"""The commands `build` and `check` of the zoo."""

import argparse
import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

from tb2rl.commands.train import train_and_evaluate
from tb2rl.core import InputError, read_text, write_text
from tb2rl.core.files import read_files, write_files
from tb2rl.evaluation.evaluate import EPISODES, evaluate
from tb2rl.evaluation.evaluation import Evaluation, load_evaluation
from tb2rl.evaluation.progress import progress, say
from tb2rl.evaluation.sim_to_sim import (
    available_physics,
    describe_place,
    describe_unavailable_physics,
    physics_simulators,
    record,
)
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.execution.arguments import make_executor
from tb2rl.execution.executor import Executor, Job
from tb2rl.runs.folder import EVALUATION, TRAINING_EVALUATIONS, Run
from tb2rl.simulation.simulator import SimulatorType, find_simulator
from tb2rl.training.training import default_folder
from tb2rl.viz.pictures import draw_paths
from tb2rl.worlds.suites import SUITES, find_suite
from tb2rl.zoo.cards import card, percent, table
from tb2rl.zoo.entry import (
    UNKNOWN_SUITE,
    UNSEEN_SUITE,
    Entry,
    entries,
    navigating_policies,
    select,
    suites_folder,
    zoo_folder,
)

_PURPOSE = "the zoo, whose evaluations use physics,"  # start of the message "... needs PyBullet"
_SPEED_TOLERANCE = 0.02  # relative difference of mean speeds between machines
_MAX_SIDE = 1280  # [pixels] of a picture
_NUM_DRAWN = 30  # number of first episodes in a picture; later episodes are drawn only if they failed
PICTURE = "paths.png"


def build(options: argparse.Namespace) -> None:
    """Train and evaluate the selected policies, and write the cards of all built entries and the README of the zoo."""
    simulators = _available_physics()
    selected, _ = select(options.names)
    if not os.access(zoo_folder(), os.W_OK):
        raise InputError(f"the zoo's folder {zoo_folder()} is not writable")
    # The BARN worlds are opened before the long training, because the path may be wrong.
    barn = [] if options.barn is None else [find_suite("barn", options.barn)]
    with make_executor(options) as executor:
        train(selected, options.again, executor)
        selected, suite_policies = select(options.names)  # new objects, because entries cache their files
        evaluate_in_unseen_worlds(selected, executor)
        evaluate_in_physics(selected, simulators, options.episodes, executor)
    policies = [*navigating_policies(selected), *suite_policies]
    online = [policy for policy in policies if policy.config.task.maps_online]
    pairs = [*product([find_suite(UNSEEN_SUITE), *barn] if policies else [], policies)]
    pairs += product([find_suite(UNKNOWN_SUITE)] if online else [], online)
    for (suite, policy), simulator in product(pairs, simulators):
        policy.evaluate_in(suite, simulator.name, options)
    built_entries = [entry for entry in entries() if entry.is_built]
    for entry in built_entries:
        write_text(entry.folder / "README.md", card(entry))
    write_text(zoo_folder() / "README.md", table(built_entries))


def check(options: argparse.Namespace) -> None:
    """Check cards and suite results, and the README if no names are given; exit with status 1 if there are problems."""
    if options.simulation is None:
        simulators = _available_physics()
    else:
        simulators = [find_simulator(options.simulation)]
        simulators[0].check(_PURPOSE)
        if simulators[0].is_external:
            raise InputError(f"the zoo is checked in simulators, and {simulators[0].title} is none")
    names, num_episodes = options.names, EPISODES if options.episodes is None else options.episodes
    selected, suite_policies = select(names)
    if not 1 <= num_episodes <= EPISODES:
        raise InputError(f"--episodes must be from 1 to {EPISODES}, got {num_episodes}")
    bar = progress(selected, "checking", "policy")
    problems = [line for entry in bar for line in _problems(entry, num_episodes, simulators, bool(options.simulation))]
    policies = [*navigating_policies(selected), *suite_policies]
    possible = (policy.file(suite, s.name) for policy in policies for suite in SUITES for s in physics_simulators())
    files = [file for file in (possible if names else suites_folder().glob("*")) if file.is_file()]
    results = [(policy, summary) for policy in policies for summaries in policy.summaries for summary in summaries]
    valid = {policy.file(summary.suite, summary.simulation) for policy, summary in results}
    stale = sorted(file for file in files if file not in valid)
    problems += [f"suites/{file.name} is stale: its policy or task has changed or is gone" for file in stale]
    if not names and read_text(zoo_folder() / "README.md") != table(selected):
        problems.append("README.md does not match the results")
    for line in problems:
        say(line)
    if problems:
        raise SystemExit(1)
    print(f"{len(selected)} cards pass" + (f", and so do {len(files)} results of suites" if files else ""))


def _available_physics() -> list[SimulatorType]:
    """The physics simulators that can run here; also prints which ones cannot."""
    simulators = available_physics(_PURPOSE)
    if missing := describe_unavailable_physics():
        say(f"without {missing}")
    return simulators


def _problems(entry: Entry, num_episodes: int, simulators: Sequence[SimulatorType], is_chosen: bool) -> list[str]:
    """Problems of an entry's files, and of its episodes in the simulators that it was evaluated in.

    If the simulators are chosen by the user, or the entry was evaluated in none of them, all of them are compared.
    """
    problems = []
    if not entry.matches_recipe:
        problems.append("it was not trained by its present recipe")
    if read_text(entry.folder / "README.md") != card(entry):
        problems.append("its card differs from its files")
    recorded = [each for each in simulators if each.name == entry.summary["simulation"] or entry.has_record(each.name)]
    for simulator in simulators if is_chosen else recorded or simulators[:1]:
        problems += _changes(entry, num_episodes, simulator)
    return [f"{entry.name}: {problem}" for problem in problems]


def _changes(entry: Entry, num_episodes: int, simulator: SimulatorType) -> list[str]:
    """Repeat the first episodes of an entry's evaluation, and compare the results with the files.

    Without an evaluation in this simulator, the results are compared with the standard evaluation.
    """
    summary = evaluate(entry.folder, episodes=num_episodes, simulation=simulator, progress_bar=True).summary()
    rate, speed, place = summary[f"{entry.criterion}_rate"], summary["mean_speed"], describe_place(simulator.name)
    say(f"{entry.name}: {percent(rate)} good episodes, {speed:.3f} m/s {place}")
    if simulator.name != entry.summary["simulation"] and entry.has_record(simulator.name):
        assert entry.sim_to_sim is not None
        record = entry.sim_to_sim.records[simulator.name]
        num_earlier = min(num_episodes, record["episodes"])
        good = num_earlier - sum(number < num_earlier for number in record["bad_episodes"])
        # A record has no speeds of single episodes, so only the mean of the same ones can be compared.
        speed_before = record["mean_speed"] if num_episodes == record["episodes"] else 0.0
    else:
        earlier_episodes = entry.summary["each"][:num_episodes]
        num_earlier = len(earlier_episodes)
        good = sum(map(entry.is_good, earlier_episodes))
        distance, num_steps = (sum(episode[name] for episode in earlier_episodes) for name in ("distance", "length"))
        speed_before = distance / (num_steps * entry.config.task.control_period)
    low, _ = wilson_interval(good, num_earlier)
    problems = []
    if rate < low:
        implied = f"its earlier evaluation implies at least {percent(low, 1)}"
        problems.append(f"{percent(rate)} good episodes {place}, but {implied}")
    if speed < (1 - _SPEED_TOLERANCE) * speed_before:
        problems.append(f"{speed:.3f} m/s {place}, but {speed_before:.3f} m/s in the same episodes before")
    return problems


def train(entries: Sequence[Entry], again: bool, executor: Executor) -> None:
    """Train and evaluate policies, and add each to the zoo as soon as it is trained.

    Args:
        entries: Entries to train.
        again: Whether to train entries again that match their recipes.
        executor: Runs the trainings.
    """
    to_train = {entry.name: entry for entry in entries if again or not entry.matches_recipe}
    jobs = []
    for name, entry in to_train.items():
        config = entry.recipe_config
        folder = default_folder(config).with_name(f"{name}-{datetime.now():%Y%m%d-%H%M%S}")
        jobs.append(Job(name, (config, str(folder), 0), folder))  # 0: `verbose` of `train_and_evaluate`
    for job, _ in executor.as_completed(train_and_evaluate, jobs, shared=[{}]):  # {}: no `worlds` from files
        assert job.folder is not None
        run, entry = Run.open(job.folder), to_train[job.name]
        draw(load_evaluation(run), job.folder / PICTURE)
        names = ("config.yaml", TRAINING_EVALUATIONS, EVALUATION, PICTURE)
        files = {name: (run.folder / name).read_bytes() for name in names}
        files[f"best/{run.policy_file.name}"] = run.policy_file.read_bytes()
        write_files(files, entry.folder)
        print(f"{job.name}: trained in {job.folder}", flush=True)


def evaluate_in_unseen_worlds(entries: Sequence[Entry], executor: Executor) -> None:
    """Make the missing evaluations of policies in unseen worlds, and write the summaries to their folders."""
    missing = {f"{entry.name} in {world}": (entry, world) for entry in entries for world in entry.missing_worlds}
    jobs = [Job(name, (read_files(entry.folder), world)) for name, (entry, world) in missing.items()]
    for job, summary in executor.as_completed(_evaluate_in_world, jobs):
        entry, world = missing[job.name]
        entry.add_unseen_world(world, summary)
        print(job.name, flush=True)


def evaluate_in_physics(
    entries: Sequence[Entry], simulators: Sequence[SimulatorType], episodes: int, executor: Executor
) -> None:
    """Make the missing records of policies in physics simulators, and write each to its entry as soon as it is made.

    A record is an evaluation like the standard one, of more episodes; it is missing, too, if it has fewer episodes.
    Where the standard evaluation has enough episodes, it is the record of its simulator.
    """
    missing = {}
    for entry, simulator in product(entries, simulators):
        if entry.has_record(simulator.name, episodes):
            continue
        if (entry.summary["simulation"], entry.summary["episodes"] >= episodes) == (simulator.name, True):
            entry.add_record(simulator.name, entry.standard_record)
        else:
            missing[f"{entry.name} {describe_place(simulator.name)}"] = entry, simulator.name
    jobs = [Job(name, (read_files(entry.folder), simulation)) for name, (entry, simulation) in missing.items()]
    for job, made in executor.as_completed(partial(_record_in_simulator, episodes), jobs):
        entry, simulation = missing[job.name]
        entry.add_record(simulation, made)
        print(job.name, flush=True)


def _record_in_simulator(episodes: int, files: Mapping[str, bytes], simulation: str) -> dict[str, Any]:
    """Record of a policy in a simulator, see `SimToSim`; `files` is the content of an entry's folder."""
    with TemporaryDirectory() as parent:
        folder = Path(parent, "entry")
        write_files(files, folder)
        return record(evaluate(folder, episodes=episodes, simulation=simulation, workers=1))


def _evaluate_in_world(files: Mapping[str, bytes], world: str) -> dict[str, Any]:
    """Summary of the standard evaluation in a world; `files` is the content of an entry's folder."""
    with TemporaryDirectory() as parent:
        folder = Path(parent, "entry")
        write_files(files, folder)
        return evaluate(folder, settings={"world": world}).summary()


def draw(evaluation: Evaluation, file: Path) -> None:
    """Draw the paths of the first episodes and of all failed ones."""
    drawn_episodes = [episode for i, episode in enumerate(evaluation.episodes) if episode.failed or i < _NUM_DRAWN]
    picture = Image.fromarray(draw_paths(evaluation.scene, drawn_episodes))
    picture.thumbnail((_MAX_SIDE, _MAX_SIDE))
    picture.quantize(64).save(file, optimize=True)
