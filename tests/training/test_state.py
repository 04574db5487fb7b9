"""A state is checked against the training that it is restored into: what does not fit is refused, in one line."""

import shutil
from copy import deepcopy

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.runs.checkpoint import read_checkpoint, restore_like, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.training.training import resume, train_config

OFF_POLICY = {"agent.learning_starts": 64, "agent.buffer_size": 400, "agent.batch_size": 16}
RAW = {"task.observation": "raw", "agent.policy_kwargs.net_arch": [8]}
NAN = float("nan")
TRAININGS = {
    "qlearn": ("qlearn", "maze", {}),
    "dqn": ("stable_baselines3:DQN", "my_tasks:Pictured", {**OFF_POLICY, **RAW}),
    "sac": ("stable_baselines3:SAC", "drive", {**OFF_POLICY, **RAW, "agent.use_sde": True}),
}
LIES = [  # training, place in its state, change, part of the message
    ("qlearn", "algorithm/_last_obs", lambda seen: seen + 100, "outside the observation space"),
    ("qlearn", "algorithm/_episode_num", None, "unknown attributes: _episode_num"),
    ("qlearn", "algorithm/ep_info_buffer", lambda _: [{"r": "x", "l": 1, "t": 0}], "ep_info_buffer"),
    ("dqn", "replay_buffer/pos", lambda position: position - 1, "observations"),
    ("sac", "replay_buffer/observations", lambda seen: seen.astype(np.float64), "observations"),
    ("dqn", "generators/numpy/state/pos", lambda _: 10**6, "numpy's generator"),
    ("qlearn", "generators/sb3/_rng", lambda _: {"bit_generator": "MT19937"}, "ValueError"),
    ("qlearn", "environments/loop/simulator/pose", lambda poses: poses[:-1], "environments.loop.simulator.pose"),
    ("qlearn", "environments/loop/simulator/initial_state", lambda start: start + 1e6, "unknown world or goal"),
    ("qlearn", "callbacks", lambda states: [{}, *states[1:]], "EpisodeStatistics"),
    ("sac", "noise/0/exploration_mat", None, "KeyError"),
]


@pytest.fixture(scope="module")
def runs(small, tmp_path_factory):
    """Runs that were killed after their first checkpoint, and its content."""
    found = {}
    for name, (agent, task, settings) in TRAININGS.items():
        config = small(agent, task, settings, total_timesteps=256, save_freq=128)
        run = train_config(config, tmp_path_factory.mktemp("runs") / name).run
        run.checkpoints[0].unlink()
        found[name] = run, read_checkpoint(run.checkpoints[0])
    return found


@pytest.mark.parametrize(
    ("name", "place", "change", "message"), LIES, ids=[f"{name}: {place}" for name, place, *_ in LIES]
)
def test_a_state_that_does_not_fit_is_refused_in_one_line(name, place, change, message, runs, tmp_path):
    run, content = runs[name]
    tree = deepcopy(content)
    *path, last = place.split("/")
    branch = tree["training"]
    for key in path:
        branch = branch[int(key) if isinstance(branch, list) else key]
    if change is None:
        del branch[last]
    else:
        branch[last] = change(branch.get(last))
    copy = Run.open(shutil.copytree(run.folder, tmp_path / "run"))
    write_checkpoint(copy.checkpoints[0], tree)
    with pytest.raises(InputError) as refused:
        resume(copy.folder)
    assert str(refused.value).startswith(f"{copy.checkpoints[0]}: the state of the training is damaged")
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_only_the_filled_rows_of_a_buffer_are_saved(runs, tmp_path):
    saved = runs["dqn"][1]["training"]["replay_buffer"]
    assert (saved["pos"], saved["full"]) == (32, False)
    assert saved["observations"]["picture"].shape == (32, 4, 1, 36, 36)
    assert len(saved["actions"]) == len(saved["rewards"]) == 32
    assert resume(shutil.copytree(runs["dqn"][0].folder, tmp_path / "run")).timesteps == 128


def test_an_array_is_written_into_the_present_one():
    present, saved = np.zeros((2, 3), order="F"), np.arange(6.0).reshape(2, 3)
    found = restore_like({"a": present}, {"a": saved}, "it")["a"]
    assert found is present
    assert found.flags.f_contiguous, "a convolution rounds otherwise for another memory layout"
    np.testing.assert_array_equal(found, saved)
