"""Many robots in PyBullet, shared out among processes: each drives as it would alone."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import signal
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.robot import RADIUS
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState, RobotState, SimulationSpec
from tb2rl.simulation.bullet.batch import BulletBatch
from tb2rl.simulation.bullet.simulator import BulletSimulator
from tb2rl.worlds.registry import find_world

WORLDS = tuple(map(find_world, ("loop", "maze")))
SETUP = SimulationSpec(ROBOT, replace(ROBOT.laser, beams=9, noise=0.02), WORLDS)
PERIOD = 0.2  # [s]


@pytest.fixture
def make():
    """`BulletBatch`, whose worlds and processes are closed after the test."""
    made = []
    yield lambda *arguments: made.append(BulletBatch(*arguments)) or made[-1]
    for batch in made:
        batch.close()


def starts(num_envs, seed=0) -> InitialState:
    """Each in one of the worlds, with a heading of its own."""
    start = InitialState.default(SETUP, num_envs, np.arange(num_envs) % 2)
    start.pose[:, 2] = np.random.default_rng(seed).uniform(-3, 3, num_envs)
    return start


def commands(steps, num_envs) -> np.ndarray:
    return np.random.default_rng(1).uniform((-0.2, -2), (0.6, 2), (steps, num_envs, 2))


def begun(batch, seed=0) -> RobotState:
    return batch.reset(starts(batch.num_envs, seed), np.random.default_rng(seed))


def assert_same(robot_state: RobotState, other: RobotState) -> None:
    np.testing.assert_equal(robot_state.state(), other.state())


def drive(batch, steps=10) -> list[dict]:
    """The readings of a drive from a start, in which the robots 0 and 3 begin anew after every fourth step."""
    seen = [begun(batch).state()]
    for step, told in enumerate(commands(steps, batch.num_envs)):
        robot_state = batch.step(told, PERIOD)
        seen.append({**robot_state.state(), "moved": batch.travelled})
        if step % 4 == 3:
            again = np.array([0, 3])
            fresh = InitialState.default(SETUP, 2, np.array([step // 4 % 2, 1]))
            robot_state, first = batch.restart(again, fresh, robot_state)
            seen += [robot_state.state(), first.state()]
    return seen


class Singles:
    """Simulations of one robot each, as a reference."""

    def __init__(self, num_envs):
        self.worlds, self.num_envs = [BulletSimulator(SETUP) for _ in range(num_envs)], num_envs

    def reset(self, start, rng):
        self.noise = rng.spawn(self.num_envs)
        return self._joined([self._begin(i, start.table[i]) for i in range(self.num_envs)])

    def step(self, commands, duration):
        before = [robot_state.pose[0] for robot_state in self.latest]
        robot_state = self._joined([w.step(c[None], duration) for w, c in zip(self.worlds, commands, strict=True)])
        self.travelled = np.hypot(*(robot_state.pose - before)[:, :2].T)
        return robot_state

    def restart(self, num_envs, start, robot_state):
        for i, row in zip(num_envs, start.table, strict=True):
            self.latest[i] = self._begin(i, row)
        return self._joined(self.latest), self._joined([self.latest[i] for i in num_envs], keep=False)

    def _begin(self, i, row):
        return self.worlds[i].reset(InitialState(row[None].copy()), self.noise[i])

    def _joined(self, readings, keep=True):
        self.latest = readings if keep else self.latest
        states = [robot_state.state() for robot_state in readings]
        return RobotState.from_state({name: np.concatenate([state[name] for state in states]) for name in states[0]})


@pytest.mark.parametrize("processes", [1, 2, 9])
def test_each_robot_drives_as_it_would_alone(processes, make):
    singles = Singles(5)
    np.testing.assert_equal(drive(make(SETUP, 5, processes)), drive(singles))
    for world in singles.worlds:
        world.close()


def test_readings_keep_what_they_show(make):
    batch = make(SETUP, 4, 2)
    first = begun(batch)
    kept = copy.deepcopy(first.state())
    second = batch.step(commands(1, 4)[0], PERIOD)
    kept_too = copy.deepcopy(second.state())
    batch.step(commands(2, 4)[1], PERIOD)
    np.testing.assert_equal([first.state(), second.state()], [kept, kept_too])
    assert (first.pose != second.pose).any(axis=1).all()


def test_the_cameras_see_where_each_robot_is(make):
    batch = make(SETUP, 4, 2)
    begun(batch)
    told = commands(1, 4)[0]
    robot_state = batch.step(told, PERIOD)
    _, first = batch.restart(np.array([1, 2]), starts(2, seed=5), robot_state)
    colours, depth = robot_state.render_camera(24, 18)
    assert (colours.shape, colours.dtype, depth.shape) == ((4, 18, 24, 3), np.uint8, (4, 18, 24))
    for some, robots in ((first, [1, 2]), (robot_state, [0, 1, 2, 3])):
        for image, robot in zip(some.look(24, 18)[0], robots, strict=True):
            np.testing.assert_array_equal(image, colours[robot])
    assert len({image.tobytes() for image in colours}) == 4
    alone = BulletSimulator(SETUP)
    alone.reset(InitialState(starts(4).table[3:]), np.random.default_rng(0))
    np.testing.assert_array_equal(alone.step(told[3:], PERIOD).look(24, 18)[0][0], colours[3])
    alone.close()


@pytest.mark.parametrize("processes", [1, 2])
def test_a_state_brings_back_all_that_follows(processes, make):
    batch = make(SETUP, 8, processes)
    begun(batch)
    for told in commands(3, 8):
        batch.step(told, PERIOD)
    state = copy.deepcopy(batch.state())
    ways = []
    for go_on in (batch, batch, make(SETUP, 8, 3)):
        if ways:
            go_on.restore(state)
        ways.append([{**go_on.step(told, PERIOD).state(), "moved": go_on.travelled} for told in commands(5, 8)])
        ways[-1].append(go_on.restart(np.array([2]), starts(1), None)[1].state())
    np.testing.assert_equal(ways[1:], [ways[0], ways[0]])


def test_the_next_way_is_counted_from_the_last_reading_though_physics_rounds_what_it_is_given(make):
    batch = make(SETUP, 3, 2)
    last = begun(batch).pose + [1e-9, 0.0, 0.0]
    batch.restore({**batch.state(), "poses": last})
    change = batch.step(commands(1, 3)[0], PERIOD).pose - last
    np.testing.assert_array_equal(batch.travelled, np.hypot(change[:, 0], change[:, 1]))


def test_a_state_in_a_world_that_is_not_there_is_refused(make):
    batch = make(SETUP, 2, 2)
    state = batch.state()
    state["worlds"][1]["initial_state"][0, 3] = 7
    with pytest.raises(ValueError, match="a world that is not there"):
        batch.restore(state)


def test_an_error_in_a_world_arrives_once_and_the_others_live_on(make):
    batch, wrong = make(SETUP, 4, 2), starts(4)
    wrong.parameters[:, RADIUS] = 0.3
    with pytest.raises(InputError, match="the robot's radius from its URDF file alone"):
        batch.reset(wrong, np.random.default_rng(0))
    assert_same(begun(batch), begun(make(SETUP, 4, 1)))


def test_what_is_interrupted_leaves_no_answer_for_the_next_question(make, monkeypatch):
    batch, other = make(SETUP, 4, 2), make(SETUP, 4, 2)
    begun(batch)

    def interrupted(duration):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(batch._share, "step", interrupted)
        with pytest.raises(KeyboardInterrupt):
            batch.step(np.ones((4, 2)), PERIOD)
    assert len(batch.state()["worlds"]) == 4
    np.testing.assert_equal(drive(batch), drive(other))


def test_a_process_that_is_killed_is_named_in_one_line(make):
    batch = make(SETUP, 3, 2)
    begun(batch)
    batch._processes[0].kill()
    batch._processes[0].join()
    for _ in range(2):
        with pytest.raises(InputError, match="a process with worlds of PyBullet has ended"):
            batch.step(np.zeros((3, 2)), PERIOD)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_that_reaches_every_process_ends_none_of_them(name, make):
    batch, other = make(SETUP, 4, 2), make(SETUP, 4, 2)
    begun(batch)
    os.kill(batch._processes[0].pid, getattr(signal, name))
    np.testing.assert_equal(drive(batch), drive(other))


@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize("copied", [copy.deepcopy, pickle.dumps])
def test_worlds_in_processes_are_not_copied(copied, processes, make):
    with pytest.raises(InputError, match="cannot be copied or sent"):
        copied(make(SETUP, 2, processes))


def test_close_ends_the_processes(make):
    before = set(multiprocessing.active_children())
    batch = make(SETUP, 3, 2)
    started = set(multiprocessing.active_children()) - before
    assert len(started) == 1  # the other share is in this process
    batch.close()
    assert not started & set(multiprocessing.active_children())
    batch.close()  # once more does no harm


def test_a_robot_that_cannot_be_loaded_leaves_no_process(tmp_path):
    before = set(multiprocessing.active_children())
    (tmp_path / "robot.urdf").write_text("no robot")
    with pytest.raises(InputError, match="PyBullet cannot load"):
        BulletBatch(replace(SETUP, robot=replace(ROBOT, urdf=tmp_path / "robot.urdf")), 2, 2)
    assert set(multiprocessing.active_children()) <= before


def test_an_error_in_another_process_where_it_opens_its_worlds_arrives(monkeypatch):
    before = set(multiprocessing.active_children())
    monkeypatch.setattr("tb2rl.simulation.bullet.batch.cloudpickle.dumps", lambda _: b"no setup")
    with pytest.raises(pickle.UnpicklingError):
        BulletBatch(SETUP, 2, 2)
    assert set(multiprocessing.active_children()) <= before


def test_threads_drive_batches_of_their_own(make):
    with ThreadPoolExecutor(2) as pool:
        ways = list(pool.map(lambda _: drive(make(SETUP, 4, 2)), range(2)))
    np.testing.assert_equal(ways[0], ways[1])
    np.testing.assert_equal(ways[0], drive(make(SETUP, 4, 1)))


@pytest.mark.slow
def test_processes_that_start_anew_serve_as_well(make, monkeypatch):
    here = drive(make(SETUP, 4, 2))
    spawn = multiprocessing.get_context("spawn")
    monkeypatch.setattr("tb2rl.simulation.bullet.batch.process_context", lambda: spawn)
    np.testing.assert_equal(drive(make(SETUP, 4, 2)), here)
