"""The command `calibrate`: from a bag to a robot file that a training takes, and a page."""

import sys

import pytest
import yaml

from tb2rl.calibrate import main
from tb2rl.play import main as play
from tb2rl.runs import resolve


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    pytest.importorskip("rosbags")
    path = tmp_path_factory.mktemp("bag") / "drive.bag"
    settings = ["task.variation={laser_noise: 0.02, bias: 0.02}", "task.beams=60"]
    arguments = ["--agent", "wallfollower", "--task", "maze", "--bag", str(path), "--simulation", "kinematic"]
    play([*arguments, "--steps", "200", "--set", *settings])
    return path


@pytest.mark.slow
def test_a_bag_becomes_a_robot_file_and_a_page(bag, tmp_path, capsys):
    pytest.importorskip("scipy")
    file = tmp_path / "my_robot.yaml"
    main([str(bag), "-o", str(file)])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 18
    assert any(line.startswith("largest turn rate") and "to know it: turn on the spot" in line for line in lines)
    tree = yaml.safe_load(file.read_text())
    low, high = tree["variation"]["laser_noise"]
    assert low < 0.02 < high
    config = resolve("random", "maze", settings={"task.robot": str(file), "task.variation": str(file)})
    assert config.task.resolved_variation.laser_noise == (low, high)
    page = file.with_suffix(".html").read_text()
    assert "Scans after the calibration" in page
    assert page.count("<svg") == 5


def test_mistakes_are_one_line(bag, tmp_path, capsys):
    pytest.importorskip("scipy")
    for arguments, message in (
        (["none.bag", "-o", str(tmp_path / "a.yaml")], "there is no bag none.bag"),
        ([str(bag), "-o", str(tmp_path / "a.txt")], "must end in .yaml"),
        ([str(bag), "-o", str(tmp_path / "none" / "a.yaml")], "cannot write"),
    ):
        with pytest.raises(SystemExit, match="2"):
            main(arguments)
        assert message in capsys.readouterr().err


def test_without_scipy_the_extra_is_named(bag, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.optimize", None)
    with pytest.raises(SystemExit, match="2"):
        main([str(bag), "-o", str(tmp_path / "a.yaml")])
    assert "calibrate needs the extra `calibrate`" in capsys.readouterr().err
