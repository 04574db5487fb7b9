"""MLflow as a tracker: the store of a training, read by MLflow's client."""

import shutil

import pytest

from tb2rl.core.errors import UnwritableError
from tb2rl.runs.folder import Run
from tb2rl.training.training import resume, train_config

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")  # of the library


mlflow = pytest.importorskip("mlflow", reason="mlflow is not installed")


@pytest.fixture(autouse=True)
def environment(monkeypatch):
    for name in ("MLFLOW_TRACKING_URI", "MLFLOW_EXPERIMENT_NAME"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """A store without runs, because making its tables takes seconds."""
    file = tmp_path_factory.mktemp("tables") / "mlflow.db"
    mlflow.MlflowClient(f"sqlite:///{file}").search_experiments()
    return file


def read(place):
    """The client of the store beside the runs, and the runs in it."""
    client = mlflow.MlflowClient(f"sqlite:///{place}/mlflow/mlflow.db")
    experiment = client.get_experiment_by_name("tb2rl")
    return client, client.search_runs([experiment.experiment_id])


def steps(client, run, key) -> list[int]:
    return [metric.step for metric in client.get_metric_history(run.info.run_id, key)]


def test_the_store_beside_the_runs_holds_a_training_and_its_resumed_part(tracked, tmp_path):
    place = tmp_path / "runs"
    folder = train_config(tracked("mlflow"), place / "maze" / "qlearn" / "mine").run.folder
    client, (run,) = read(place)
    assert (run.info.run_name, run.info.status) == ("maze/qlearn/mine", "FINISHED")
    params = run.data.params
    assert (params["agent.name"], params["task.world"], params["train.seed"]) == ("qlearn", "loop", "0")
    assert steps(client, run, "eval/score") == [64, 128]
    assert 0.0 <= run.data.metrics["rollout/failure_rate"] <= 1.0
    pictures = [file.path for file in client.list_artifacts(run.info.run_id, "images")]
    assert sum(path.endswith(".png") and "paths" in path for path in pictures) == 2

    (folder / "checkpoints" / "step-0000000128.safetensors").unlink()  # as if killed after logging
    client.update_run(run.info.run_id, status="RUNNING")
    resume(folder, 192)
    client, (again,) = read(place)
    assert (again.info.run_id, again.info.status) == (run.info.run_id, "FINISHED")
    for key in again.data.metrics:
        seen = steps(client, again, key)
        assert seen == sorted(set(seen)), key
    assert steps(client, again, "eval/score") == [64, 128, 192]


def test_a_run_that_is_not_in_the_store_starts_again(tracked, tables, tmp_path, monkeypatch):
    (tmp_path / "mlflow").mkdir()
    for name in ("mlflow/mlflow.db", "other.db"):
        shutil.copy(tables, tmp_path / name)
    monkeypatch.chdir(tmp_path)  # where MLflow puts pictures, if the store is a database that the user names
    folder = train_config(tracked("mlflow"), tmp_path / "run").run.folder
    for checkpoint in Run.open(folder).checkpoints[1:]:  # as if killed
        checkpoint.unlink()
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/other.db")
    monkeypatch.setenv("MLFLOW_EXPERIMENT_NAME", "mine")
    resume(folder, 192)
    client = mlflow.MlflowClient(f"sqlite:///{tmp_path}/other.db")
    (run,) = client.search_runs([client.get_experiment_by_name("mine").experiment_id])
    assert (run.info.status, steps(client, run, "eval/score")) == ("FINISHED", [132, 192])


def test_a_failed_training_is_marked_as_failed(tracked, tables, tmp_path):
    (tmp_path / "mlflow").mkdir()
    shutil.copy(tables, tmp_path / "mlflow")
    with pytest.raises(ZeroDivisionError):
        train_config(tracked("mlflow"), tmp_path / "run", on_evaluation=lambda _: 1 / 0)
    client, (run,) = read(tmp_path)
    assert (run.info.status, steps(client, run, "eval/score")) == ("FAILED", [64])


@pytest.mark.parametrize("uri", ["", "http://127.0.0.1:9", "sqlite:///mlflow", "nonsense://x"])
def test_a_store_that_cannot_be_written_is_an_error(uri, tracked, tmp_path, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mlflow").write_text("not a database, and in the way of the store beside the runs")
    with pytest.raises(UnwritableError, match=r"^train\.track: mlflow cannot write: "):
        train_config(tracked("mlflow"), tmp_path / "run")
