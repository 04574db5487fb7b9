"""Learning curves come from the files of a run; seeds have a mean where all of them have values."""

import json

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.viz.charts import MAX_POINTS, Curve, SeedCurves
from tb2rl.viz.run_views import read_curves


def test_curves_come_from_the_files_of_the_run(seeds):
    curves = read_curves(seeds / "seed-0", False)
    lines = [json.loads(line) for line in (seeds / "seed-0" / "evaluations.jsonl").read_text().splitlines()]
    assert curves["failure_free_rate"].steps.tolist() == [line["timesteps"] for line in lines] == [12_000, 24_000]
    assert curves["failure_free_rate"].values.tolist() == [line["failure_free_rate"] for line in lines]
    assert curves["rollout/ep_rew_mean"].steps[-1] == 24_000
    assert (np.diff(curves["rollout/ep_len_mean"].steps) > 0).all()
    assert ((curves["rollout/failure_rate"].values >= 0) & (curves["rollout/failure_rate"].values <= 1)).all()


def test_an_event_file_is_read_up_to_its_first_damage(seeds, make, tmp_path):
    run = make.copied(seeds / "seed-0", tmp_path / "run")
    (file,) = (run / "tensorboard").iterdir()
    whole = read_curves(run, False)["rollout/ep_rew_mean"]
    data = file.read_bytes()
    file.write_bytes(data[: data.rindex(b"rollout/ep_rew_mean")])
    read = read_curves(run, False)["rollout/ep_rew_mean"]
    assert 0 < len(read.steps) < len(whole.steps)
    assert read.values.tolist() == whole.values[: len(read.values)].tolist()
    file.write_bytes(b"")
    assert read_curves(run, False).keys() == {"failure_free_rate"}


@pytest.mark.parametrize("content", ["{", "[]", '{"timesteps": 1}', '{"timesteps": "x", "failure_free_rate": NaN}'])
def test_damaged_evaluations_are_refused_by_name(content, tmp_path):
    (tmp_path / "evaluations.jsonl").write_text(content + "\n")
    with pytest.raises(InputError, match=r"evaluations\.jsonl is damaged"):
        read_curves(tmp_path, False)


def test_an_incomplete_last_evaluation_is_left_out_and_a_run_without_files_has_no_curves(tmp_path):
    assert read_curves(tmp_path, True) == {}
    line = '{"timesteps": 1, "failure_free_rate": 0.5, "success_rate": 0.25}\n'
    (tmp_path / "evaluations.jsonl").write_text(line + '{"timesteps": 2, "fail')
    assert read_curves(tmp_path, True)["success_rate"].values.tolist() == [0.25]


def test_seeds_have_a_mean_and_an_interval_where_all_of_them_have_values():
    first = Curve(np.array([0.0, 10.0, 20.0]), np.array([0.0, 1.0, 2.0]))
    second = Curve(np.array([10.0, 30.0]), np.array([3.0, 5.0]))
    both = SeedCurves("", "", [first, second])
    assert both.mean.steps.tolist() == [10.0, 20.0]
    assert both.mean.values.tolist() == [2.0, 3.0]
    assert both.interval.tolist() == [list(bootstrap_interval([1.0, 3.0])), list(bootstrap_interval([2.0, 4.0]))]
    assert both.is_cut
    apart = SeedCurves("", "", [first, Curve(second.steps + 100.0, second.values)])
    assert (len(apart.mean.steps), apart.interval.shape) == (0, (0, 2))
    assert not SeedCurves("", "", [first, Curve(first.steps, 2 * first.values)]).is_cut


def test_a_long_curve_is_thinned_but_keeps_its_ends():
    thinned = Curve(np.arange(1000.0), np.arange(1000.0) ** 2).downsample()
    assert len(thinned.steps) == MAX_POINTS
    assert (thinned.steps[0], thinned.steps[-1]) == (0.0, 999.0)
    assert (thinned.values == thinned.steps**2).all()
