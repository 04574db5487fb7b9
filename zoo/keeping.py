"""What the command of the zoo does: builds entries and writes their pages, or checks that these hold."""

from __future__ import annotations

import argparse
import os

from tb2rl.errors import InputError
from tb2rl.files import read_text, write_text
from tb2rl.judging.evaluator import EPISODES
from tb2rl.judging.progress import progress, say
from tb2rl.simulation import check_bullet
from tb2rl.zoo.building import build
from tb2rl.zoo.cards import card, table
from tb2rl.zoo.checking import check
from tb2rl.zoo.entry import Entry, entries, zoo_folder


def run(options: argparse.Namespace) -> None:
    """Build the zoo or check it; status 1 if a card does not hold."""
    check_bullet("the zoo, whose cards are of PyBullet,")
    chosen = entries(options.names)
    if options.what == "build":
        _build(chosen, options.again)
    elif not _check(chosen, EPISODES if options.episodes is None else options.episodes, whole=not options.names):
        raise SystemExit(1)


def _build(chosen: list[Entry], again: bool) -> None:
    """Build some entries, then write the cards and the table of all that are there."""
    if not os.access(zoo_folder(), os.W_OK):
        raise InputError(f"the zoo's folder {zoo_folder()} is not writable")
    for number, entry in enumerate(chosen, start=1):
        print(f"{entry.name} ({number} of {len(chosen)})", flush=True)
        build(entry, again)
    there = [entry for entry in entries() if entry.is_built]
    for entry in there:
        write_text(entry.folder / "README.md", card(entry))
    write_text(zoo_folder() / "README.md", table(there))


def _check(chosen: list[Entry], episodes: int, whole: bool) -> bool:
    """Check some entries, and the table if these are all; whether everything holds."""
    if not 1 <= episodes <= EPISODES:
        raise InputError(f"--episodes must be from 1 to {EPISODES}, got {episodes}")
    wrong = [line for entry in progress(chosen, "checking", "policy") for line in check(entry, episodes)]
    if whole and read_text(zoo_folder() / "README.md") != table(chosen):
        wrong.append("the table in README.md is not what the files say")
    for line in wrong:
        say(line)
    if not wrong:
        print(f"{len(chosen)} cards hold")
    return not wrong
