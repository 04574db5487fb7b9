"""Every policy of the zoo, exported, acts as it does itself: as an ONNX file, and by numpy alone."""

from __future__ import annotations

import numpy as np
import pytest

from tb2rl.commands.export import export_onnx
from tb2rl.core.files import top_folder
from tb2rl.runs.loading import config_of

NAMES = sorted(entry.parent.name for entry in top_folder("zoo").glob("*/config.yaml"))
QUICK = ("drive-loop-ppo", "drive-loop-sac", "drive-loop-td3", "maze-loop-dqn", "maze-loop-ppo", "wall-wall-qlearn")
SAME = 1e-5  # of shares from -1 to 1; named actions are the same


def assert_same(got: np.ndarray, expected: np.ndarray) -> None:
    assert (got.dtype, got.shape) == (expected.dtype, expected.shape)
    if expected.dtype.kind == "i":
        assert np.flatnonzero(got != expected).tolist() == []
    else:
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=SAME)


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *[(name, 1_000) for name in QUICK],
        *[pytest.param(name, 10_000, marks=pytest.mark.slow) for name in NAMES],
    ],
)
def test_an_exported_policy_of_the_zoo_acts_the_same(name, count, states, runner, loaded, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime")
    policy = loaded(f"zoo:{name}")
    observations = states(policy, count)
    expected, _ = policy.predict(observations, deterministic=True)
    export_onnx(f"zoo:{name}", tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    action, command = session.run(["action", "command"], {"observation": observations})
    assert_same(action, expected)
    np.testing.assert_allclose(command, config_of(policy).scene.actions.commands(expected), rtol=0.0, atol=SAME)
    run = runner(policy)
    assert_same(run(observations), expected)
    each = np.concatenate([run(observations[robot : robot + 1]) for robot in range(0, count, 10)])
    assert_same(each, expected[::10])  # one by one, as a robot asks: other sums, rounded otherwise
