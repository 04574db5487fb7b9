"""The commands `build` and `check` of the zoo."""

from __future__ import annotations

import argparse
import os

from tb2rl.core.errors import InputError
from tb2rl.core.files import read_text, write_text
from tb2rl.evaluation.evaluator import EPISODES
from tb2rl.evaluation.progress import progress, say
from tb2rl.execution.arguments import executor_arguments, make_executor
from tb2rl.simulation import default_physics
from tb2rl.worlds.suites import find_suite
from tb2rl.zoo.building import build
from tb2rl.zoo.cards import card, table
from tb2rl.zoo.checking import check
from tb2rl.zoo.entry import UNSEEN, entries, select, suite_policies_of, suites_folder, zoo_folder
from tb2rl.zoo.suite_policies import stale_results


def run(options: argparse.Namespace) -> None:
    """Build the zoo or check it; status 1 if a card does not hold."""
    default_physics().check("the zoo, whose cards are of PyBullet,")
    if options.what == "build":
        _build(options)
    elif not _check(options.names, EPISODES if options.episodes is None else options.episodes):
        raise SystemExit(1)


def _build(options: argparse.Namespace) -> None:
    """Build entries, drive through suites, then write the cards and the table of all entries."""
    chosen, _ = select(options.names)
    if not os.access(zoo_folder(), os.W_OK):
        raise InputError(f"the zoo's folder {zoo_folder()} is not writable")
    barn = [] if options.barn is None else [find_suite("barn", options.barn)]  # an unreadable file fails at once
    with make_executor(options) as executor:
        build(chosen, options.again, executor)
    chosen, others = select(options.names)  # read again, because some may be new now
    drivers = [*suite_policies_of(chosen), *others]
    for suite in [find_suite(UNSEEN), *barn] if drivers else []:
        for driver in drivers:
            driver.drive(suite, options.again, executor_arguments(options))
    built = [entry for entry in entries() if entry.is_built]
    for entry in built:
        write_text(entry.folder / "README.md", card(entry))
    write_text(zoo_folder() / "README.md", table(built))


def _check(names: list[str], episodes: int) -> bool:
    """Check entries and results of suites, and the table if these are all; whether everything holds."""
    chosen, others = select(names)
    if not 1 <= episodes <= EPISODES:
        raise InputError(f"--episodes must be from 1 to {EPISODES}, got {episodes}")
    wrong = [line for entry in progress(chosen, "checking", "policy") for line in check(entry, episodes)]
    drivers = [*suite_policies_of(chosen), *others]
    files = [file for driver in drivers for file in driver.files] if names else list(suites_folder().glob("*"))
    wrong += stale_results(files, drivers)
    if not names and read_text(zoo_folder() / "README.md") != table(chosen):
        wrong.append("the table in README.md is not what the files say")
    for line in wrong:
        say(line)
    if not wrong:
        print(f"{len(chosen)} cards hold" + (f", and {len(files)} results of suites" if files else ""))
    return not wrong
