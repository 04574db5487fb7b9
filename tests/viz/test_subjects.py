"""The runs that a report shows: which ones a reference means, what they are called, and what is refused."""

from __future__ import annotations

import pytest

from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.runs.folder import EVALUATION, PATHS, Run
from tb2rl.runs.loading import load
from tb2rl.viz.subjects import names_of, read_subject, run_folders


def refused(run) -> str:
    """The one line in which a run is refused."""
    with pytest.raises(InputError) as error:
        read_subject(run, "it")
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_folder_of_runs_means_each_of_them_and_each_run_counts_once(seeds, goal_run):
    both = [seeds / "seed-0", seeds / "seed-1"]
    assert run_folders([str(seeds)]) == both
    assert run_folders([str(seeds / "seed-1"), str(seeds), str(goal_run)]) == [both[1], both[0], goal_run]


def test_runs_are_called_by_what_their_paths_do_not_share(seeds, goal_run):
    assert names_of([seeds / "seed-0"]) == ["seed-0"]
    assert names_of([seeds / "seed-0", seeds / "seed-1"]) == ["seed-0", "seed-1"]
    zoo = top_folder("zoo").resolve()
    assert names_of([zoo / "maze-loop-ppo", seeds / "seed-0"]) == ["zoo:maze-loop-ppo", "seed-0"]
    apart = names_of([seeds / "seed-0", goal_run])
    assert [name.split("/")[-1] for name in apart] == ["seed-0", "goal"]
    assert apart[0].endswith("seeds/seed-0")


def test_runs_on_two_drives_are_called_by_their_whole_paths(seeds, goal_run, monkeypatch):
    def two_drives(paths):
        raise ValueError("Paths don't have the same drive")

    monkeypatch.setattr("os.path.commonpath", two_drives)  # as on Windows
    assert names_of([seeds / "seed-0", goal_run]) == [str(seeds / "seed-0"), str(goal_run)]


@pytest.mark.parametrize(
    ("reference", "said"),
    [
        ("missing", "no run folder missing"),
        (".", "neither a run folder nor a folder of them"),
        ("file", "no run folder file"),
        ("zoo:missing", "unknown zoo policy 'missing'"),
    ],
)
def test_what_is_not_a_run_is_refused(reference, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=said):
        run_folders([reference])


def test_a_folder_whose_runs_lie_deeper_says_where(tmp_path):
    for run in ("ppo/today", "qlearn/today"):
        (tmp_path / "Errand" / run).mkdir(parents=True)
        (tmp_path / "Errand" / run / "config.yaml").touch()
    with pytest.raises(InputError, match=r"no config\.yaml is in it; take .*Errand/ppo$"):
        run_folders([str(tmp_path / "Errand")])
    assert run_folders([str(tmp_path / "Errand" / "ppo")]) == [tmp_path / "Errand" / "ppo" / "today"]


def test_a_run_is_read_with_its_evaluation_and_its_curves(seeds):
    subject = read_subject(seeds / "seed-1", "second")
    assert (subject.name, subject.kept, subject.trained) == ("second", True, 24_000)
    assert [episode.ended for episode in subject.evaluation.episodes] == ["collision"] * 3
    assert subject.failures == 3
    assert subject.summary["failure_free_rate"] == 0.0
    assert subject.curves.keys() >= {"rollout/ep_rew_mean", "failure_free_rate"}
    assert "success_rate" not in subject.curves, "without a goal it is the rate of what did not fail"
    assert subject.versions.keys() >= {"tb2rl", "torch"}
    assert subject.action_names == ("forward", "left", "right")
    assert subject.action_shares.sum() == pytest.approx(1.0)


def test_a_run_without_an_evaluation_is_evaluated(goal_run, brief):
    subject = read_subject(goal_run, "it")
    assert not subject.kept
    assert len(subject.evaluation.episodes) == 1
    assert subject.visits is None


@pytest.mark.parametrize(("place", "stays"), [("final/policy", True), ("best/policy", False)])
def test_an_evaluation_goes_with_the_policy_that_it_is_of(place, stays, seeds, make, brief, pages, tmp_path):
    run = Run.open(make.copied(seeds / "seed-0", tmp_path / "run"))
    assert "was driven for this page" not in pages.of(run.folder).text
    run.save(load(run.folder), place)
    assert [(run.folder / file).exists() for file in (EVALUATION, PATHS)] == [stays, stays]
    assert ("was driven for this page" not in pages.of(run.folder).text) == stays


@pytest.mark.parametrize("settings", [{"world": "circuit"}, {"beams": 5}])
def test_a_config_that_is_not_its_policys_is_refused(settings, seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run", "task", **settings)
    assert "config.yaml is not what its policy was trained with" in refused(run)


def test_paths_without_their_end_are_refused(seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run")
    (run / PATHS).write_bytes((run / PATHS).read_bytes()[:-100])
    message = refused(run)
    assert PATHS in message
    assert "damaged" in message


@pytest.mark.parametrize("damage", ["flipped", "junk", "length"])
def test_a_damaged_event_file_is_refused(damage, seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run")
    (file,) = (run / "tensorboard").iterdir()
    data = bytearray(file.read_bytes())
    place = {"flipped": len(data) // 2, "length": 0, "junk": 0}[damage]
    data[place] ^= 0xFF
    file.write_bytes(b"no events at all, and more of that" if damage == "junk" else data)
    message = refused(run)
    assert file.name in message
    assert "damaged; remove it" in message


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("evaluations.jsonl", "{\n"),
        ("evaluations.jsonl", '{"timesteps": 1}\n'),
        ("evaluations.jsonl", "[]\n"),
        ("evaluations.jsonl", '{"timesteps": 1e999, "failure_free_rate": 1, "success_rate": 1}\n'),
        ("evaluations.jsonl", '{"timesteps": 1, "failure_free_rate": NaN, "success_rate": 1}\n'),
        ("evaluations.jsonl", f'{{"timesteps": 1{400 * "0"}, "failure_free_rate": 1, "success_rate": 1}}\n'),
        ("evaluation.json", "{}"),
        ("config.yaml", "agent: {name: qlern}\ntask: {name: maze}"),
        ("best/policy.safetensors", "no arrays"),
    ],
)
def test_other_damaged_files_are_refused_by_name(file, content, seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run")
    (run / file).write_text(content)
    assert file in refused(run)
