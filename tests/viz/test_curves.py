"""Learning curves come from the files of a run as far as these go; seeds have a mean where all of them have values."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.viz.curves import POINTS, Curve, Family, read_curves, read_evaluations, read_events


def test_curves_come_from_the_files_of_the_run(seeds):
    curves = read_curves(seeds / "seed-0")
    notes = [json.loads(line) for line in (seeds / "seed-0" / "evaluations.jsonl").read_text().splitlines()]
    assert curves["failure_free_rate"].steps.tolist() == [note["timesteps"] for note in notes] == [12_000, 24_000]
    assert curves["failure_free_rate"].values.tolist() == [note["failure_free_rate"] for note in notes]
    assert curves["rollout/ep_rew_mean"].steps[-1] == 24_000
    assert (np.diff(curves["rollout/ep_len_mean"].steps) > 0).all()
    assert ((curves["rollout/failure_rate"].values >= 0) & (curves["rollout/failure_rate"].values <= 1)).all()


def test_a_run_without_files_has_no_curves(tmp_path):
    assert read_curves(tmp_path) == {}
    (tmp_path / "evaluations.jsonl").touch()
    assert read_curves(tmp_path) == {}


def test_an_event_file_without_its_end_is_read_as_far_as_it_goes(seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run")
    (file,) = (run / "tensorboard").iterdir()
    whole = read_curves(run)["rollout/ep_rew_mean"]
    data = file.read_bytes()
    file.write_bytes(data[: data.rindex(b"rollout/ep_rew_mean")])
    cut = read_curves(run)["rollout/ep_rew_mean"]
    assert 0 < len(cut.steps) < len(whole.steps)
    assert cut.values.tolist() == whole.values[: len(cut.values)].tolist()
    file.write_bytes(b"")
    assert read_curves(run).keys() == {"failure_free_rate", "success_rate"}


def test_a_damaged_event_file_is_refused_by_name(seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run")
    (file,) = (run / "tensorboard").iterdir()
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(InputError, match=f"{file.name} is damaged; remove it to go without its curves"):
        read_events(run / "tensorboard")


@pytest.mark.parametrize("content", ["{", '{"timesteps": 1}', "[]", '{"timesteps": 1, "failure_free_rate": NaN}'])
def test_damaged_notes_are_refused_by_name(content, tmp_path):
    (tmp_path / "evaluations.jsonl").write_text(content + "\n")
    with pytest.raises(InputError, match=r"evaluations\.jsonl is damaged"):
        read_evaluations(tmp_path / "evaluations.jsonl")


@pytest.mark.parametrize("end", ['{"timesteps": 2, "fail', "\n", "\0" * 40], ids=["torn", "blank", "zeros"])
def test_a_last_note_that_was_not_written_to_its_end_is_left_out(end, tmp_path):
    note = '{"timesteps": 1, "failure_free_rate": 0.5, "success_rate": 0.25}\n'
    (tmp_path / "evaluations.jsonl").write_text(note + end)
    assert read_evaluations(tmp_path / "evaluations.jsonl")["success_rate"].values.tolist() == [0.25]
    (tmp_path / "evaluations.jsonl").write_text(end)
    assert read_evaluations(tmp_path / "evaluations.jsonl") == {}


def test_seeds_have_a_mean_and_an_interval_where_all_of_them_have_values():
    first = Curve(np.array([0.0, 10.0, 20.0]), np.array([0.0, 1.0, 2.0]))
    second = Curve(np.array([10.0, 30.0]), np.array([3.0, 5.0]))
    family = Family("", "", [first, second])
    assert family.mean.steps.tolist() == [10.0, 20.0]
    assert family.mean.values.tolist() == [2.0, 3.0]
    assert family.interval.tolist() == [list(bootstrap_interval([1.0, 3.0])), list(bootstrap_interval([2.0, 4.0]))]
    assert family.cut
    apart = Family("", "", [first, Curve(second.steps + 100.0, second.values)])
    assert (len(apart.mean.steps), apart.interval.shape) == (0, (0, 2))
    assert not Family("", "", [first, Curve(first.steps, 2 * first.values)]).cut


def test_a_long_curve_is_thinned_but_keeps_its_ends():
    curve = Curve(np.arange(1000.0), np.arange(1000.0) ** 2)
    thinned = curve.thinned()
    assert len(thinned.steps) == POINTS
    assert (thinned.steps[0], thinned.steps[-1]) == (0.0, 999.0)
    assert (thinned.values == thinned.steps**2).all()
    assert thinned.thinned() is thinned
