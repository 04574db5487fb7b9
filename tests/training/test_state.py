"""A state is held against the training that it is put into: what does not fit is refused, in one line."""

from __future__ import annotations

import shutil
from copy import deepcopy

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.training.training import resume, train_config

OFF_POLICY = {"agent.learning_starts": 64, "agent.buffer_size": 400, "agent.batch_size": 16}
RAW = {"task.observation": "raw", "agent.policy_kwargs.net_arch": [8]}
TRAININGS = {
    "qlearn": ("qlearn", "maze", {}),
    "dqn": ("stable_baselines3:DQN", "maze", {**OFF_POLICY, **RAW}),
    "images": ("stable_baselines3:DQN", "my_tasks:Pictured", {**OFF_POLICY, **RAW}),
    "noisy": ("stable_baselines3:SAC", "my_tasks:Glide", {**OFF_POLICY, **RAW, "agent.use_sde": True}),
}
LIES = [  # training, place in its state, what becomes of it, part of the message
    ("qlearn", "algorithm/_last_obs", lambda seen: seen + 100, "outside the observation space"),
    ("dqn", "algorithm/_last_obs", lambda seen: seen * np.float32("nan"), "outside the observation space"),
    ("dqn", "algorithm/_last_obs", lambda seen: seen[:2], "_last_obs"),
    ("dqn", "algorithm/_last_obs", lambda seen: seen.astype(float), "_last_obs"),
    ("images", "algorithm/_last_obs", lambda seen: seen["numbers"], "_last_obs"),
    ("images", "algorithm/_last_obs/picture", lambda seen: seen[:, :, :9], "_last_obs.picture"),
    ("qlearn", "algorithm/_last_episode_starts", lambda starts: starts[:1], "_last_episode_starts"),
    ("dqn", "algorithm/gamma", lambda _: 0.5, "gamma is 0.5, and the config says"),
    ("dqn", "algorithm/batch_size", lambda _: 10**9, "batch_size is 1000000000, and the config says 16"),
    ("dqn", "algorithm/_n_updates", lambda _: float("nan"), "_n_updates"),
    ("qlearn", "algorithm/policy", lambda _: 1, "other attributes: policy"),
    ("qlearn", "algorithm/_episode_num", None, "other attributes: _episode_num"),
    ("qlearn", "algorithm/ep_info_buffer", lambda _: [{"r": "x", "l": 1, "t": 0}], "ValueError"),
    ("dqn", "replay_buffer/pos", lambda _: 100, "position is outside"),
    ("dqn", "replay_buffer/pos", lambda _: -1, "position is outside"),
    ("dqn", "replay_buffer/pos", lambda position: position - 1, "observations"),
    ("dqn", "replay_buffer/pos", lambda _: 1.5, "position is outside"),
    ("dqn", "replay_buffer/full", lambda _: True, "observations"),
    ("dqn", "replay_buffer/full", lambda _: 3, "position is outside"),
    ("dqn", "replay_buffer/observations", lambda seen: seen[..., :-1], "observations"),
    ("dqn", "replay_buffer/buffer_size", lambda _: 10**12, "buffer_size"),
    ("images", "replay_buffer/observations/picture", lambda seen: seen[:-1], "observations.picture"),
    ("images", "replay_buffer/observations", lambda seen: seen["picture"], "observations"),
    ("dqn", "generators/numpy/state/pos", lambda _: 10**6, "numpy's generator"),
    ("dqn", "generators/torch", lambda state: state[:3], "RuntimeError"),
    ("dqn", "generators/python", lambda state: [7, *state[1:]], "ValueError"),
    ("qlearn", "generators/own/_rng", lambda _: {"bit_generator": "MT19937"}, "ValueError"),
    ("qlearn", "environments", lambda _: [], "environments"),
    ("qlearn", "environments/simulation/poses", lambda poses: poses[:-1], "environments.simulation.poses"),
    ("qlearn", "environments/simulation/poses", lambda poses: poses.astype(np.float32), "environments.simulation"),
    ("qlearn", "environments/simulation/start", lambda start: start + 1e6, "world that is not there"),
    ("qlearn", "environments/simulation/rims", lambda wheel_speeds: wheel_speeds + 1e30, "faster than they can"),
    (
        "qlearn",
        "environments/simulation/rims",
        lambda wheel_speeds: wheel_speeds * float("nan"),
        "faster than they can",
    ),
    ("qlearn", "callbacks", lambda states: states[:-1], "ValueError"),
    ("noisy", "noise", lambda _: [], "ValueError"),
    ("noisy", "noise/0/exploration_mat", None, "KeyError"),
]
NAMES = [f"{name}: {place}" for name, place, *_ in LIES]


@pytest.fixture(scope="module")
def runs(small, tmp_path_factory):
    """Runs that were killed after their first checkpoint, and what is in it."""
    found = {}
    for name, (agent, task, settings) in TRAININGS.items():
        config = small(agent, task, settings, total_timesteps=256, save_freq=128)
        run = train_config(config, tmp_path_factory.mktemp("runs") / name).run
        run.checkpoints[0].unlink()
        found[name] = run, read_checkpoint(run.checkpoints[0])
    return found


@pytest.mark.parametrize(("name", "place", "change", "message"), LIES, ids=NAMES)
def test_what_does_not_fit_is_refused_in_one_line(name, place, change, message, runs, tmp_path):
    run, content = runs[name]
    tree = deepcopy(content)
    *path, last = place.split("/")
    branch = tree["training"]
    for key in path:
        branch = branch[int(key) if isinstance(branch, list) else key]
    if change is None and last in branch:
        del branch[last]
    else:
        branch[last] = change(branch.get(last))
    copy = Run.open(shutil.copytree(run.folder, tmp_path / "run"))
    write_checkpoint(copy.checkpoints[0], tree)
    with pytest.raises(InputError) as refused:
        resume(copy.folder)
    assert str(refused.value).startswith(f"{copy.checkpoints[0]}: the state does not fit this training")
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", TRAININGS)
def test_what_fits_goes_on(name, runs, tmp_path):
    folder = shutil.copytree(runs[name][0].folder, tmp_path / "run")
    assert resume(folder).timesteps == 128


def test_a_buffer_is_saved_as_far_as_it_is_filled(runs):
    saved = runs["images"][1]["training"]["replay_buffer"]
    assert (saved["pos"], saved["full"]) == (32, False)
    assert saved["observations"]["picture"].shape == (32, 4, 1, 36, 36)
    assert len(saved["actions"]) == len(saved["rewards"]) == 32
