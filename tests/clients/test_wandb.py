"""Weights & Biases as a tracker: its offline files, read as the library's messages."""

import json
import struct
import time
from collections.abc import Iterator

import pytest

from tb2rl.core.errors import UnwritableError
from tb2rl.training.training import resume, train_config

wandb = pytest.importorskip("wandb", reason="wandb is not installed")

pytestmark = [  # the library writes in a process of its own
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning"),
    pytest.mark.flaky(reruns=1),
]
_BLOCK = 2**15


@pytest.fixture(autouse=True)
def environment(monkeypatch):
    for name in ("WANDB_MODE", "WANDB_PROJECT", "WANDB_API_KEY"):
        monkeypatch.delenv(name, raising=False)


def records(content: bytes) -> Iterator[bytes]:
    """Records of a file in LevelDB's log format: pieces in blocks, after a header of the library.

    A piece has a checksum (4 bytes), a length (2), a kind (1: whole, 2: first, 3: middle, 4: last) and its content.
    """
    assert content[:4] == b":W&B"
    at, record = 7, b""
    while at < len(content):
        if (left := _BLOCK - at % _BLOCK) < 7:
            at += left
            continue
        length, kind = struct.unpack_from("<HB", content, at + 4)
        record += content[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):
            yield record
            record = b""


class Offline:
    """Content of the offline file of a run."""

    def __init__(self, folder) -> None:
        from wandb.proto import wandb_internal_pb2

        (file,) = folder.glob("*.wandb")
        self.rows, self.exit, self.kinds = [], None, set()
        for data in records(file.read_bytes()):
            record = wandb_internal_pb2.Record.FromString(data)
            kind = record.WhichOneof("record_type")
            self.kinds.add(kind)
            if kind == "run":
                self.run = record.run
                self.config = {item.key: json.loads(item.value_json) for item in record.run.config.update}
            elif kind == "history":
                values = {"/".join(item.nested_key): json.loads(item.value_json) for item in record.history.item}
                self.rows.append(values)
            elif kind == "exit":
                self.exit = record.exit.exit_code

    def steps(self, key: str) -> list[int]:
        return [row["_step"] for row in self.rows if key in row]


def parts(folder) -> list[Offline]:
    """Parts of a run in the order of their creation."""
    deadline = time.monotonic() + 60  # [s] the library's process writes on for a moment after the run is finished
    while time.monotonic() < deadline:
        found = [Offline(part) for part in folder.glob("wandb/offline-run-*")]
        if all(part.exit is not None for part in found):
            return sorted(found, key=lambda part: part.rows[0]["_step"])
        time.sleep(0.05)
    raise AssertionError("a file of wandb has no exit record after 60 s")


def test_a_training_and_its_resumed_part_are_one_run_of_two_files(tracked, tmp_path, capfd):
    folder = train_config(tracked("wandb"), tmp_path / "runs" / "maze" / "qlearn" / "mine").run.folder
    (part,) = parts(folder)
    assert (part.run.display_name, part.run.project, part.exit) == ("maze/qlearn/mine", "tb2rl", 0)
    assert (part.config["agent.name"], part.config["task.world"], part.config["train.seed"]) == ("qlearn", "loop", 0)
    assert part.steps("eval/score") == [64, 128]
    rates = [row["rollout/failure_rate"] for row in part.rows if "rollout/failure_rate" in row]
    assert rates
    assert all(0.0 <= rate <= 1.0 for rate in rates)
    pictures = [row["eval/paths/path"] for row in part.rows if "eval/paths/path" in row]
    (files,) = folder.glob("wandb/offline-run-*/files")
    assert [(files / path).is_file() for path in pictures] == [True, True]
    assert not part.kinds & {"stats", "output_raw", "output"}  # of the machine, of the terminal
    assert not (files / "requirements.txt").exists()

    (folder / "checkpoints" / "step-0000000128.safetensors").unlink()  # as if killed after logging
    resume(folder, 192)
    part, again = parts(folder)
    assert again.run.run_id == part.run.run_id
    assert (part.steps("eval/score"), again.steps("eval/score")) == ([64, 128], [192])
    assert min(row["_step"] for row in again.rows) > 128
    assert again.config["train.total_timesteps"] == 192
    assert capfd.readouterr() == ("", "")


def test_a_failed_training_is_marked_as_failed(tracked, tmp_path):
    with pytest.raises(ZeroDivisionError):
        train_config(tracked("wandb"), tmp_path / "run", on_evaluation=lambda _: 1 / 0)
    (part,) = parts(tmp_path / "run")
    assert (part.exit, part.steps("eval/score")) == (1, [64])


@pytest.mark.parametrize(("name", "value"), [("WANDB_PROJECT", "a/b"), ("WANDB_MODE", "ofline")])
def test_a_wrong_environment_variable_is_an_error(name, value, tracked, tmp_path, monkeypatch):
    monkeypatch.setenv(name, value)
    with pytest.raises(UnwritableError, match=r"^train\.track: wandb cannot write: "):
        train_config(tracked("wandb"), tmp_path / "run")
