"""Many environments in PyBullet, distributed over processes: each drives as it would alone."""

import copy
import multiprocessing
import os
import pickle
import signal
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.worlds.registry import find_world

bullet = pytest.importorskip("tb2rl.simulation.bullet.batch", reason="PyBullet is not installed")

WORLDS = tuple(map(find_world, ("loop", "maze")))
SPEC = SimulationSpec(ROBOT, replace(ROBOT.laser, beams=9, noise=0.02), WORLDS)
PERIOD = 0.2  # [s]


@pytest.fixture
def make(open_simulator):
    """A function from the numbers of environments and of processes to a `BulletBatch`, closed after the test."""
    return lambda num_envs, processes=2: open_simulator("bullet", SPEC, num_envs, processes)


def initial_states(num_envs, seed=0) -> InitialState:
    """Alternating between the worlds, with random headings."""
    initial_state = InitialState.default(SPEC, num_envs, np.arange(num_envs) % 2)
    initial_state.pose[:, 2] = np.random.default_rng(seed).uniform(-3, 3, num_envs)
    return initial_state


def commands(steps, num_envs) -> np.ndarray:
    return np.random.default_rng(1).uniform((-0.2, -2), (0.6, 2), (steps, num_envs, 2))


def reset(batch, seed=0) -> RobotState:
    return batch.reset(initial_states(batch.num_envs, seed), np.random.default_rng(seed))


def drive(batch, steps=10) -> list[dict]:
    """The states of a drive in which the environments 0 and 3 are reset after every fourth step."""
    states = [reset(batch).state()]
    for step, command in enumerate(commands(steps, batch.num_envs)):
        robot_state = batch.step(command, PERIOD)
        states.append(robot_state.state() | {"travelled": batch.travelled})
        if step % 4 == 3:
            fresh = InitialState.default(SPEC, 2, np.array([step // 4 % 2, 1]))
            robot_state, first = batch.reset_at(np.array([0, 3]), fresh)
            states.append(robot_state.state())
            np.testing.assert_equal(first.state(), {name: rows[[0, 3]] for name, rows in states[-1].items()})
    return states


def drive_alone(i, num_envs, steps=10) -> list[dict]:
    """The same drive of environment `i` in a simulator of its own."""
    with closing(bullet.BulletSimulator(SPEC)) as simulation:
        noise = np.random.default_rng(0).spawn(num_envs)[i]
        states = [simulation.reset(InitialState(initial_states(num_envs).table[[i]]), noise).state()]
        for step, command in enumerate(commands(steps, num_envs)):
            robot_state = simulation.step(command[[i]], PERIOD)
            states.append(robot_state.state())
            if step % 4 == 3:
                if i in (0, 3):
                    fresh = InitialState.default(SPEC, 1, step // 4 % 2 if i == 0 else 1)
                    robot_state, _ = simulation.reset_at(np.array([0]), fresh)
                states.append(robot_state.state())
    return states


@pytest.mark.parametrize("processes", [2, 9])
def test_each_environment_drives_as_it_would_alone(processes, make):
    together, alone = drive(make(5, processes)), [drive_alone(i, 5) for i in range(5)]
    for number, state in enumerate(together):
        for name in alone[0][number]:
            rows = np.concatenate([states[number][name] for states in alone])
            np.testing.assert_array_equal(state[name], rows, name)


def test_skipped_environments_stay_where_they_are(make):
    batch, inactive = make(4), np.array([True, False, True, False])
    before = reset(batch).pose
    after = batch.step(np.full((4, 2), 0.5), PERIOD, inactive).pose
    np.testing.assert_array_equal((after == before).all(axis=1), inactive)


def test_the_cameras_show_the_view_of_each_robot(make):
    batch, command = make(4), commands(1, 4)[0]
    reset(batch)
    robot_state = batch.step(command, PERIOD)
    _, first = batch.reset_at(np.array([1, 2]), initial_states(2, seed=5))
    colours, depth = robot_state.render_camera(24, 18)
    assert (colours.shape, colours.dtype, depth.shape) == ((4, 18, 24, 3), np.uint8, (4, 18, 24))
    np.testing.assert_array_equal(first.render_camera(24, 18)[0], colours[1:3])
    assert len({image.tobytes() for image in colours}) == 4
    with closing(bullet.BulletSimulator(SPEC)) as alone:
        alone.reset(InitialState(initial_states(4).table[3:]), np.random.default_rng(0))
        np.testing.assert_array_equal(alone.step(command[3:], PERIOD).render_camera(24, 18)[0][0], colours[3])


def test_batches_of_any_number_of_processes_continue_from_a_state(make):
    batch = make(8)
    reset(batch)
    for command in commands(3, 8):
        batch.step(command, PERIOD)
    state = copy.deepcopy(batch.state())
    drives = []
    for other in (batch, batch, make(8, 3)):
        if drives:
            other.restore(state)
        states = [{**other.step(each, PERIOD).state(), "travelled": other.travelled} for each in commands(5, 8)]
        drives.append([*states, other.reset_at(np.array([2]), initial_states(1))[1].state()])
    np.testing.assert_equal(drives[1:], [drives[0], drives[0]])


def test_an_error_in_one_environment_is_raised_once_and_the_others_go_on(make):
    batch, wrong = make(4), initial_states(4)
    wrong.records["radius"] = 0.3
    with pytest.raises(InputError, match="PyBullet cannot change the robot's radius"):
        batch.reset(wrong, np.random.default_rng(0))
    np.testing.assert_equal(reset(batch).state(), reset(make(4, 1)).state())


def test_after_an_interrupt_the_next_request_gets_its_own_answer(make, monkeypatch):
    batch = make(4)
    reset(batch)

    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(batch._group, "call", interrupt)
        with pytest.raises(KeyboardInterrupt):
            batch.step(np.ones((4, 2)), PERIOD)
    assert len(batch.state()["worlds"]) == 4
    np.testing.assert_equal(drive(batch), drive(make(4)))


def test_signals_that_reach_every_process_end_none_of_them(make):
    batch = make(4)
    reset(batch)
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        os.kill(batch._processes[0].pid, getattr(signal, name))
    np.testing.assert_equal(drive(batch), drive(make(4)))


@pytest.mark.parametrize(("processes", "copied"), [(1, copy.deepcopy), (2, pickle.dumps)])
def test_a_batch_is_not_copied(copied, processes, make):
    with pytest.raises(InputError, match="cannot be copied or pickled"):
        copied(make(2, processes))


def test_close_ends_the_processes(make):
    before = set(multiprocessing.active_children())
    batch = make(3)
    started = set(multiprocessing.active_children()) - before
    assert len(started) == 1  # the other environments are in this process
    batch.close()
    assert not started & set(multiprocessing.active_children())
    batch.close()


def test_an_error_while_the_worlds_open_is_raised_and_leaves_no_process(make, tmp_path, monkeypatch):
    before = set(multiprocessing.active_children())
    (tmp_path / "robot.urdf").write_text("no robot")
    with pytest.raises(InputError, match="PyBullet cannot load"):
        bullet.BulletBatch(replace(SPEC, robot=replace(ROBOT, urdf=tmp_path / "robot.urdf")), 2, 2)
    monkeypatch.setattr("tb2rl.simulation.bullet.batch.cloudpickle.dumps", lambda _: b"no spec")
    with pytest.raises(pickle.UnpicklingError):  # of the other process
        make(2)
    assert set(multiprocessing.active_children()) <= before


@pytest.mark.slow
def test_spawned_processes_drive_as_well(make, monkeypatch):
    expected = drive(make(4))
    spawn = multiprocessing.get_context("spawn")
    monkeypatch.setattr("tb2rl.simulation.bullet.batch.process_context", lambda: spawn)
    np.testing.assert_equal(drive(make(4)), expected)
