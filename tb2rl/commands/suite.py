"""What `evaluate --suite` does, see `tb2rl.evaluate`: a table, and JSON where it belongs."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tb2rl.commands.evaluate import check_places
from tb2rl.commands.policy import chosen_policy
from tb2rl.commands.robot import chosen_robot
from tb2rl.core.compiled import announce_compiling
from tb2rl.core.errors import InputError
from tb2rl.core.files import write_text
from tb2rl.core.values import build
from tb2rl.evaluation.progress import progress
from tb2rl.evaluation.spaces import check_observes
from tb2rl.evaluation.suite_result import Drive, SuiteResult
from tb2rl.evaluation.suites import SuiteEvaluation, drives_of, suite_evaluator, suite_scene
from tb2rl.execution.where import where_of
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run
from tb2rl.runs.journal import Journal
from tb2rl.runs.layers import parse_settings
from tb2rl.runs.loading import policy_digest
from tb2rl.runs.versions import versions
from tb2rl.viz.table import print_suite
from tb2rl.worlds.suites import Suite, find_suite


def run(options: argparse.Namespace) -> None:
    """Drive a policy through a suite, print a table, write JSON."""
    announce_compiling()
    check(options)
    suite = find_suite(options.suite[0], Path(options.suite[1]) if options.suite[1:] else None)
    policy, config = chosen_policy(options)
    scene = suite_scene(config.scene, suite)
    check_observes(policy, scene)
    about = _about(options)
    where = where_of(options) if options.on else None
    with suite_evaluator(scene, 1 if where else options.workers) as evaluator:
        file = _result_file(options, suite)
        journal = _journal(file, suite, config, {**about, "simulation": evaluator.simulation})
        drives = _kept(journal)
        _say_how_it_goes_on(journal, len(drives), len(suite.worlds))
        rest = drives_of(evaluator, policy, len(drives), where)
        for drive in progress(rest, "evaluating", "world", total=len(suite.worlds) - len(drives)):
            journal.note(asdict(drive))
            drives.append(drive)
        result = SuiteEvaluation(suite, scene, drives, evaluator.simulation).result(config, **about)
    if file is not None:
        _write(file, result)
    journal.remove()
    print_suite(result)


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` where options do not go together."""
    check_places(options)
    chosen_robot(options)  # refuses options of a robot alone
    if options.simulation is not None:
        raise InputError("--simulation does not go with --suite, whose figures are of PyBullet wherever it works")
    if options.goal is not None:
        raise InputError("--goal does not go with --suite: each of its worlds has a goal")
    if len(options.suite) > 2:
        raise InputError("--suite takes a name, and for barn a path; name the policy before it")
    for name in ("episodes", "steps", "seed"):
        if getattr(options, name) is not None:
            raise InputError(f"--{name} does not go with --suite: a suite says itself what is driven, and how long")
    if "task.episode_steps" in parse_settings(options.set):
        raise InputError("task.episode_steps does not go with --suite: each suite has a time limit")


def _about(options: argparse.Namespace) -> dict[str, Any]:
    """The policy's name, and a digest of its file; an agent that does not learn has none."""
    if options.agent is not None:
        return {"policy": f"agent {options.agent}", "policy_digest": None}
    return {"policy": str(options.policy), "policy_digest": policy_digest(options.policy, options.trust)}


def _result_file(options: argparse.Namespace, suite: Suite) -> Path | None:
    """The file that is named, or that of the run folder, where the task is the one that was trained; else None."""
    if options.json:
        return Path(options.json)
    if options.policy and Path(options.policy).is_dir() and not options.set:
        return Run.open(Path(options.policy), options.trust).suite_file(suite.name)
    return None


def _journal(file: Path | None, suite: Suite, config: Config, about: dict[str, Any]) -> Journal:
    """What is kept beside the result while it is not complete."""
    path = None if file is None else file.with_name(f"{file.name}.journal")
    rules = {"name": suite.name, "digest": suite.digest, "time": suite.time_limit, "goal_radius": suite.goal_radius}
    return Journal(path, {**about, "suite": rules, "config": config.to_dict(), "versions": versions()})


def _kept(journal: Journal) -> list[Drive]:
    drives = [build(Drive, entry, f"{journal.path}: line {line}") for line, entry in enumerate(journal.entries, 2)]
    if [drive.world for drive in drives] != list(range(len(drives))):
        raise InputError(f"{journal.path} does not hold one world after the other; remove it to start anew")
    return drives


def _say_how_it_goes_on(journal: Journal, done: int, worlds: int) -> None:
    if journal.path is None:
        print("not kept: only a run folder at its own task keeps the result of a suite; --json FILE keeps any")
    elif journal.other is not None:
        print(f"starting anew: what was in {journal.path} has another {journal.other}")
    elif done:
        print(f"going on where it was: {done} of {worlds} worlds are in {journal.path}")


def _write(file: Path, result: SuiteResult) -> None:
    try:
        write_text(file, json.dumps(asdict(result), indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise InputError(f"cannot write {file}: {error.strerror}") from None
