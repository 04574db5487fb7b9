"""What the command of the zoo does: builds entries and writes their pages, or checks that these hold."""

from __future__ import annotations

import argparse
import os

from tb2rl.core.errors import InputError
from tb2rl.core.files import read_text, write_text
from tb2rl.evaluation.evaluator import EPISODES
from tb2rl.evaluation.progress import progress, say
from tb2rl.execution.arguments import executor_arguments, make_executor
from tb2rl.simulation import default_physics
from tb2rl.worlds.suites import Suite, find_suite
from tb2rl.zoo.building import build
from tb2rl.zoo.cards import card, table
from tb2rl.zoo.checking import check
from tb2rl.zoo.contestants import astray
from tb2rl.zoo.entry import UNSEEN, contestants_of, entries, named, suites_folder, zoo_folder


def run(options: argparse.Namespace) -> None:
    """Build the zoo or check it; status 1 if a card does not hold."""
    default_physics().check("the zoo, whose cards are of PyBullet,")
    if options.what == "build":
        _build(options)
    elif not _check(options.names, EPISODES if options.episodes is None else options.episodes):
        raise SystemExit(1)


def _build(options: argparse.Namespace) -> None:
    """Build some entries and drive through suites, then write the cards and the table of all that is there."""
    names, again, barn = options.names, options.again, options.barn
    executor = make_executor(options)
    chosen, _ = named(names)
    if not os.access(zoo_folder(), os.W_OK):
        raise InputError(f"the zoo's folder {zoo_folder()} is not writable")
    given = [] if barn is None else [find_suite("barn", barn)]  # it may say that it cannot be read: now, not at the end
    with executor:
        build(chosen, again, executor)
    _drive(names, again, given, executor_arguments(options))
    there = [entry for entry in entries() if entry.is_built]
    for entry in there:
        write_text(entry.folder / "README.md", card(entry))
    write_text(zoo_folder() / "README.md", table(there))


def _drive(names: list[str], again: bool, given: list[Suite], arguments: list[str]) -> None:
    """Drive through `unseen` and the suites given: the entries that navigate, as they are now, and the others."""
    chosen, rest = named(names)
    contestants = [*contestants_of(chosen), *rest]
    for suite in [find_suite(UNSEEN), *given] if contestants else []:  # made once, for it takes seconds
        for contestant in contestants:
            contestant.drive(suite, again, arguments)


def _check(names: list[str], episodes: int) -> bool:
    """Check some entries and summaries of suites, and the table if these are all; whether everything holds."""
    chosen, rest = named(names)
    if not 1 <= episodes <= EPISODES:
        raise InputError(f"--episodes must be from 1 to {EPISODES}, got {episodes}")
    wrong = [line for entry in progress(chosen, "checking", "policy") for line in check(entry, episodes)]
    contestants = [*contestants_of(chosen), *rest]
    kept = [file for each in contestants for file in each.files] if names else list(suites_folder().glob("*"))
    wrong += astray(kept, contestants)
    if not names and read_text(zoo_folder() / "README.md") != table(chosen):
        wrong.append("the table in README.md is not what the files say")
    for line in wrong:
        say(line)
    if not wrong:
        print(f"{len(chosen)} cards hold" + (f", and {len(kept)} results of suites" if kept else ""))
    return not wrong
