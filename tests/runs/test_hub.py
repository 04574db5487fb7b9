"""Policies of the hub can come from anybody: they are data and drive as before; all else is refused in one line."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import PurePath

import numpy as np
import pytest

from tb2rl import report
from tb2rl.core.errors import install_extra
from tb2rl.core.files import top_folder
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.runs.loading import config_of, load, policy_digest
from tb2rl.zoo.sharing import prepare_upload

EVIL = """
from pathlib import Path

from tb2rl.tasks.wander import Wander

Path(__file__).with_name("executed").touch()

class Task(Wander):
    pass
"""


@pytest.fixture(scope="session")
def shared(tmp_path_factory) -> dict[str, bytes]:
    """The files of a policy as `push` uploads them."""
    folder = tmp_path_factory.mktemp("shared")
    prepare_upload(Run.open(top_folder("zoo") / "maze-loop-ppo"), "ada/maze", folder)
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*.*")}


@pytest.fixture
def with_config(shared, tmp_path):
    """A function that changes a value in the config of the shared policy, in both files."""

    def change(section: str, key: str, value: object) -> dict[str, bytes]:
        file = tmp_path / "changed.safetensors"
        file.write_bytes(shared["best/policy.safetensors"])
        content, config = read_checkpoint(file), json.loads(shared["config.json"])
        content["config"][section][key] = config[section][key] = value
        write_checkpoint(file, content)
        return {**shared, "best/policy.safetensors": file.read_bytes(), "config.json": json.dumps(config).encode()}

    return change


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A module that Python finds, and that leaves a file where it is executed."""
    (tmp_path / "evil.py").write_text(EVIL)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path / "executed"
    sys.modules.pop("evil", None)


def test_a_policy_of_the_hub_equals_its_files(hub, shared):
    hub.put("ada/maze", shared)
    theirs, ours = load("hf:ada/maze"), load("zoo:maze-loop-ppo")
    assert config_of(theirs) == config_of(ours)
    for name, tensor in ours.policy.state_dict().items():
        np.testing.assert_array_equal(theirs.policy.state_dict()[name], tensor)
    assert policy_digest("hf:ada/maze") == hashlib.sha256(shared["best/policy.safetensors"]).hexdigest()


def test_a_revision_is_pinned_and_the_newest_is_the_default(hub, shared, with_config):
    first = hub.put("ada/maze", shared)
    hub.put("ada/maze", with_config("task", "laser_noise", 0.01))
    assert config_of(load("hf:ada/maze")).task.laser_noise == 0.01
    assert config_of(load(f"hf:ada/maze@{first}")).task.laser_noise == 0.0


def test_a_downloaded_policy_is_available_without_a_connection(hub, shared, refused, monkeypatch):
    hub.put("ada/maze", shared)
    load("hf:ada/maze")
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", "http://127.0.0.1:9")
    assert config_of(load("hf:ada/maze")).task.world == "loop"
    assert "hf:ada/other: " in (message := refused(load, "hf:ada/other"))
    assert "check your internet connection" in message


def test_only_the_files_of_a_policy_are_downloaded(hub, shared):
    others = ("policy.pkl", "evil.py", "config.yaml", "../evil.json", "best/evil.so")
    hub.put("ada/maze", {**shared, **dict.fromkeys(others, b"\x80\x02}q\x00.")})
    load("hf:ada/maze")
    found = {path.name for path in hub.cache.rglob("*.*")}
    assert {"config.json", "policy.safetensors"} <= found
    assert not {PurePath(path).name for path in others} & found


@pytest.mark.parametrize("name", ["config.json", "best/policy.safetensors"])
def test_a_repository_without_a_policy_is_refused(name, hub, shared, refused):
    hub.put("ada/maze", {path: content for path, content in shared.items() if path != name})
    assert "hf:ada/maze is not a policy of tb2rl" in refused(load, "hf:ada/maze")


@pytest.mark.parametrize(
    ("section", "key", "value", "named"),
    [
        ("agent", "name", "os:system", "os"),
        ("agent", "policy_kwargs", {"features_extractor_class": "evil:Net"}, "evil"),
        ("agent", "policy", "evil:Policy", "evil"),
        ("task", "name", "best.evil:Task", "best.evil"),
        ("task", "robot", "evil:ROBOT", "evil"),
        ("task", "observe", ["evil:Sensor"], "evil"),
        ("task", "world", {"generator": "evil:make"}, "evil"),
        ("task", "world", "evil:read:/etc/passwd", "/etc/passwd"),
        ("task", "world", {"file": "hall.yaml"}, "hall.yaml"),
    ],
)
def test_a_config_may_not_name_other_modules_or_files(section, key, value, named, hub, with_config, refused, evil):
    hub.put("ada/maze", with_config(section, key, value))
    message = refused(load, "hf:ada/maze")
    assert "hf:ada/maze names the " in message
    assert repr(named) in message
    assert "trust=True, or --trust" in message
    assert "evil" not in sys.modules
    assert not evil.exists()


def test_with_trust_any_module_is_imported(hub, with_config, evil):
    hub.put("ada/maze", with_config("task", "name", "evil:Task"))
    assert config_of(load("hf:ada/maze", trust=True)).task_name == "evil:Task"
    assert evil.exists()


def test_a_shared_run_in_a_local_folder_is_untrusted_too(with_config, refused, evil, tmp_path):
    for path, content in with_config("task", "name", "evil:Task").items():
        (tmp_path / "theirs" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "theirs" / path).write_bytes(content)
    assert "names the module 'evil'" in refused(load, tmp_path / "theirs")
    assert "names the module 'evil'" in refused(load, tmp_path / "theirs" / "best" / "policy.safetensors")
    assert not evil.exists()
    assert config_of(load(tmp_path / "theirs", trust=True)).task_name == "evil:Task"


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("config.json", b"{", "is not a JSON object"),
        ("config.json", b'{"agent": {"name": "os:system"}}', "has no task.name"),
        ("best/policy.safetensors", b"\x80\x04\x95.", "is not a checkpoint"),
        ("best/policy.safetensors", b"../../../../../etc/passwd", "is not a checkpoint"),  # as git stores a link
    ],
)
def test_a_damaged_file_is_refused(name, content, named, hub, shared, refused):
    hub.put("ada/maze", {**shared, name: content})
    assert named in refused(load, "hf:ada/maze")


@pytest.mark.parametrize("reference", ["hf:a/b/c", "hf:../x"])
def test_a_malformed_reference_is_refused(reference, hub, refused):
    assert reference in refused(load, reference)


@pytest.mark.parametrize(
    ("status", "code", "named"),
    [
        (401, "GatedRepo", "gated repo"),
        (404, "RepoNotFound", "Repository Not Found"),
        (404, "RevisionNotFound", "Revision Not Found"),
        (500, "", "500 Internal Server Error"),
        (403, "", "token has the correct permissions"),
    ],
)
def test_an_error_of_the_hub_is_one_line(status, code, named, hub, refused):
    hub.refuses = status, code
    assert named in refused(load, "hf:ada/maze")


def test_without_the_library_the_extra_is_named(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    assert refused(load, "hf:ada/maze") == f"the hub needs the extra `hub`: {install_extra('hub')}"


def test_the_hub_is_not_contacted_for_other_policies(hub, refused):
    load("zoo:maze-loop-qlearn")
    refused(load, "ada/maze")
    assert hub.authorisations == []


@pytest.mark.slow
def test_a_command_reports_an_untrusted_module_in_one_line(hub, with_config, evil, tmp_path):
    hub.put("ada/maze", with_config("task", "name", "evil:Task"))
    command = [sys.executable, "-m", "tb2rl", "convert", "hf:ada/maze", "policy.zip"]
    settings = {"cwd": tmp_path, "env": os.environ | {"HF_TOKEN": "hf_secret"}, "capture_output": True, "text": True}
    done = subprocess.run(command, **settings, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "hf:ada/maze names the module 'evil'" in done.stderr
    assert not evil.exists()
    done = subprocess.run([*command, "--trust"], **settings, check=False)
    assert done.returncode == 0, done.stderr
    assert evil.exists()
    assert "Bearer hf_secret" in hub.authorisations
    assert "hf_secret" not in done.stdout + done.stderr


@pytest.mark.slow
def test_a_report_is_made_of_a_policy_of_the_hub(hub, shared, tmp_path, monkeypatch):
    hub.put("ada/maze", shared)
    monkeypatch.chdir(tmp_path)
    report.main(["hf:ada/maze"])
    assert "hf:ada/maze" in (tmp_path / "report.html").read_text(encoding="utf-8")
