"""A policy in several physics simulators: records, the difference paired by episode, and the file."""

import json
import shutil

import pytest

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.sim_to_sim import (
    BY_SIMULATION,
    SimToSim,
    available_physics,
    describe_place,
    describe_unavailable_physics,
    explain_place,
    load_sim_to_sim,
)
from tb2rl.runs.folder import EVALUATION, Run
from tb2rl.tasks.wander import Wander


@pytest.fixture
def evaluation_in(make_episode, referees):
    """A function that makes an evaluation of 20 episodes, some of which collide."""
    scene = make_scene(Wander(), "raw")

    def make(simulation: str, collided: set[int], total: int = 20, seed: int = 1) -> Evaluation:
        episodes = [make_episode("collision" if i in collided else "time limit", length=1) for i in range(total)]
        return Evaluation(episodes, scene, seed, simulation)

    return make


def test_the_difference_is_paired_by_episode(evaluation_in):
    comparison = SimToSim.of([evaluation_in("first", {3}), evaluation_in("second", {3, 5, 7})])
    assert comparison.titles == ["First", "Second"]
    assert [each["bad_episodes"] for each in comparison.records.values()] == [[3], [3, 5, 7]]
    apart = SimToSim.of([evaluation_in("first", {0}), evaluation_in("second", {3, 5, 7})])
    difference, wider = comparison.differences["second"], apart.differences["second"]
    assert difference.value == wider.value == pytest.approx(-0.1)
    assert difference.high - difference.low < wider.high - wider.low, "the same episode collides in both"
    low, high = (f"{100 * bound:.1f}" for bound in (difference.low, difference.high))
    assert comparison.sentences == [
        f"sim-to-sim difference (failure-free) Second - First: -10.0 points (95 % interval {low} to {high}),"
        " paired over 20 episodes"
    ]
    (label, (first, second)), *_ = comparison.rows
    assert (label, first[0], second[0]) == ("failure-free", "95.0 %", "85.0 %")
    assert comparison.worst()["simulation"] == "second"
    assert SimToSim.of([evaluation_in("first", {1}), evaluation_in("second", set())]).worst()["simulation"] == "first"


def test_records_of_other_lengths_are_paired_over_their_common_episodes(evaluation_in):
    comparison = SimToSim.of([evaluation_in("first", {1, 15}), evaluation_in("second", {1}, total=10)])
    assert comparison.differences["second"].value == 0.0
    assert comparison.sentences[0].endswith("paired over 10 episodes")


def test_evaluations_with_other_episodes_are_refused(evaluation_in):
    with pytest.raises(InputError, match="cannot be paired"):
        SimToSim.of([evaluation_in("first", {1}), evaluation_in("second", {1}, seed=2)])


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda tree: tree["first"].pop("bad_episodes"), "bad_episodes"),
        (lambda tree: tree["second"].update(mean_distance="far"), "far|format"),
        (lambda tree: tree.update(gazebo=tree.pop("first")), "gazebo"),
        (lambda tree: tree.update(first=3), "int"),
    ],
)
def test_a_comparison_is_read_as_it_was_written_and_refused_if_it_is_damaged(
    damage, named, trained_run, tmp_path, referees
):
    run = Run.open(shutil.copytree(trained_run, tmp_path / "run"))
    assert load_sim_to_sim(run) is None
    evaluations = [evaluate(run.folder, episodes=3, steps=30, simulation=name) for name in ("first", "second")]
    tree, arrays = evaluations[0].serialize(run.config, "its name")
    run.write_evaluation({**tree, BY_SIMULATION: SimToSim.of(evaluations).to_json()}, arrays)
    back = load_sim_to_sim(run)
    assert (back.rows, back.differences) == (SimToSim.of(evaluations).rows, SimToSim.of(evaluations).differences)
    written = json.loads((run.folder / EVALUATION).read_text())
    difference, found = back.differences["second"], written[BY_SIMULATION]["second"]
    assert (found["difference"], found["difference_interval"]) == (difference.value, [difference.low, difference.high])
    damage(written[BY_SIMULATION])
    (run.folder / EVALUATION).write_text(json.dumps(written))
    with pytest.raises(InputError, match=named) as refused:
        load_sim_to_sim(run)
    assert "\n" not in str(refused.value)


def test_the_simulator_of_a_sentence_has_its_reason(referees):
    assert [simulator.name for simulator in available_physics("it")] == ["first", "second"]
    assert [describe_place(name) for name in ("first", "kinematic")] == ["in First", "in the kinematic simulator"]
    assert explain_place("first") == "in First"
    assert describe_unavailable_physics() == ""
    referees("Second", available=False)
    assert [simulator.name for simulator in available_physics("it")] == ["first"]
    assert describe_unavailable_physics() == "Second is not installed"


def test_without_the_first_physics_the_second_one_is_the_default_and_says_why(referees):
    referees("First", available=False)
    assert explain_place("second") == "in Second, because First is not installed"
    assert explain_place("kinematic") == "in the kinematic simulator", "it was chosen"
