"""Compares the results of a policy in a suite in several simulators, and stores them in one file."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.core import InputError, one_line, read_text
from tb2rl.core.values import build
from tb2rl.evaluation.sim_to_sim import BY_SIMULATION, describe_difference, difference_in_json
from tb2rl.evaluation.statistics import Estimate, paired_difference
from tb2rl.evaluation.suites import ALL, SuiteResult
from tb2rl.simulation import find_simulator


def read_results(file: Path) -> list[SuiteResult]:
    """Read the results of a file in one simulator or several, see `results_in_json`.

    Raises:
        InputError: If the file cannot be read, or is not a result.
    """
    try:
        tree = json.loads(read_text(file))
        if BY_SIMULATION not in tree:
            return [SuiteResult.read(file)]
        trees = tree[BY_SIMULATION].values()
        plain = [{key: each[key] for key in each if not key.startswith("difference")} for each in trees]
        if not plain:
            raise ValueError("it has no result")
        return [build(SuiteResult, each, "result") for each in plain]
    except (AttributeError, TypeError, ValueError, RecursionError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{file} is not the result of a suite: {error}")) from None


def suite_title(results: Sequence[SuiteResult]) -> str:
    """The title of the first result, with the titles of all simulators."""
    return results[0].title_with(" and ".join(find_simulator(result.simulation).title for result in results))


def suite_differences(results: Sequence[SuiteResult]) -> dict[str, Estimate]:
    """Success rate of each other result minus that of the first, paired by world, by name of the simulator.

    Results that lack their worlds, or have other worlds than the first, are left out.
    """
    (first, *others), differences = results, {}
    worlds, missed = np.arange(first.figures[ALL].worlds), first.unsuccessful_worlds
    for other in others:
        others_missed = other.unsuccessful_worlds
        if missed is not None and others_missed is not None and other.suite_digest == first.suite_digest:
            differences[other.simulation] = paired_difference(~np.isin(worlds, missed), ~np.isin(worlds, others_missed))
    return differences


def suite_sentences(results: Sequence[SuiteResult]) -> list[str]:
    """A sentence about each of the `suite_differences`."""
    return [
        f"sim-to-sim difference (success) {describe_difference(results[0].simulation, name, difference)}, paired over"
        f" {results[0].figures[ALL].worlds} worlds"
        for name, difference in suite_differences(results).items()
    ]


def results_in_json(results: Sequence[SuiteResult]) -> dict[str, Any]:
    """The results of a policy in a suite for a file: a single one as it is, several by name of the simulator."""
    if len(results) == 1:
        return asdict(results[0])
    differences = {name: difference_in_json(each) for name, each in suite_differences(results).items()}
    return {BY_SIMULATION: {r.simulation: {**asdict(r), **differences.get(r.simulation, {})} for r in results}}
