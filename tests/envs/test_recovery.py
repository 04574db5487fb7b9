"""The recovery filter: a robot that stands for too long turns to free space, and drives there."""

import math

import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.envs.filters import SensedState
from tb2rl.envs.parts import robot_facts
from tb2rl.envs.recovery import Recovery
from tb2rl.envs.safety import Safety
from tb2rl.envs.scene import make_scene
from tb2rl.runs.config import resolve
from tb2rl.tasks.navigate import Navigate

PERIOD, PATIENCE = 0.1, 2.0  # [s]
STEPS = round(PATIENCE / PERIOD)  # for which a robot may stand
TURN, DRIVE = [0.0, 1.5], [0.4, 0.0]


@pytest.fixture
def stand():
    """A function that lets robots stand before a wall for some steps, and returns the commands of the last robot."""
    scene = make_scene(Navigate(variation="none"), "raw")
    angles = scene.laser.angles

    def make(num_envs=1):
        recovery = Recovery(robot_facts(scene.task, scene.spec), patience=PATIENCE)
        recovery.reset(num_envs)

        def step(steps, free=None, command=(0.3, -0.2), speed=0.0, recovery=recovery):
            ranges = np.full((num_envs, len(angles)), 0.5)
            if free is not None:
                ranges[:, np.abs(angles - free) < 0.48] = 2.0
            twist, zeros = np.tile([speed, 0.0], (num_envs, 1)), np.zeros((num_envs, 2))
            sensed = SensedState(ranges, np.zeros((num_envs, 3)), twist, zeros[:, 0] > 0, zeros, zeros[:, 0])
            commands = np.tile(command, (num_envs, 1))
            return [recovery(commands, sensed)[-1].tolist() for _ in range(steps)]

        return step, recovery

    return make


@pytest.mark.parametrize("side", [-0.95, 0.95])
def test_a_robot_that_stands_turns_to_free_space_drives_on_and_obeys_again(stand, side):
    step, recovery = stand()
    assert step(STEPS, free=side) == [[0.3, -0.2]] * STEPS
    assert not recovery.reason(0)
    turns = step(7, free=side)  # 0.95 rad at 1.5 rad/s
    assert turns == [[0.0, math.copysign(1.5, side)]] * 7
    assert recovery.reason(0)
    assert step(15, free=side) == [DRIVE] * 15  # 1.5 s
    assert step(STEPS, free=side) == [[0.3, -0.2]] * STEPS
    assert step(1, free=side) != [[0.3, -0.2]]


def test_a_robot_that_drives_or_pauses_is_left_alone(stand):
    step, _ = stand()
    assert step(10 * STEPS, speed=0.1) == [[0.3, -0.2]] * 10 * STEPS
    for _ in range(10):  # stands half of the time
        assert step(STEPS // 2) + step(STEPS // 2, speed=0.3) == [[0.3, -0.2]] * STEPS


def test_a_robot_with_the_command_to_stand_may_do_so(stand):
    step, recovery = stand()
    assert step(3 * STEPS, command=(0.0, 0.0)) == [[0.0, 0.0]] * 3 * STEPS
    assert step(STEPS + 1)[-1] == TURN
    assert step(1, command=(0.0, 0.0)) == [[0.0, 0.0]]
    assert step(1) == [[0.3, -0.2]]
    assert not recovery.reason(0)


@pytest.mark.parametrize("free", [None, 0.0])
def test_without_room_at_its_sides_it_turns_around(stand, free):
    step, _ = stand()
    commands = step(STEPS + 22, free=free)
    assert commands[STEPS:] == [TURN] * 21 + [DRIVE]  # half a turn at 1.5 rad/s takes 2.1 s


def test_it_turns_around_each_third_time(stand):
    step, _ = stand()
    lengths = []
    for _ in range(6):
        step(STEPS, free=-0.95)
        commands = step(40, free=-0.95, command=(0.1, 0.0))
        lengths.append(sum(w != 0.0 for _, w in commands))
        step(STEPS, speed=0.3)
    assert lengths == [7, 7, 21, 7, 7, 21]


def test_its_memory_restarts_with_the_episode_and_continues_from_a_state(stand):
    (step, recovery), (other_step, other) = stand(2), stand(2)
    step(STEPS + 3, free=1.0)
    other.restore(recovery.state())
    assert step(25, free=1.0) == other_step(25, free=1.0)
    other.restore(recovery.state())
    other.reset_at(np.array([1]))
    others, own = other.state(), recovery.state()
    for name, values in own.items():
        assert others[name].tolist() == [values[0], 0]


def test_a_driver_that_only_turns_reaches_other_places_without_a_contact():
    filters = [{"recovery": {"patience": 0.5}}, "safety"]
    env = make_env("navigate", simulation="kinematic", filters=filters)
    env.reset(seed=0)
    start, farthest = env.unwrapped.robot_state.pose[0, :2].copy(), 0.0
    for _ in range(300):
        terminated = env.step(np.array([-1.0, 0.01], np.float32))[2]
        farthest = max(farthest, math.dist(start, env.unwrapped.robot_state.pose[0, :2]))
        assert not terminated or env.unwrapped.robot_state.bumped[0] == 0
    assert farthest > 1.0


def test_a_policy_learns_without_it():
    filters = [{"recovery": {"patience": 0.5}}, "safety"]
    config = resolve("ppo", "navigate", settings={"task.filters": filters})
    assert [type(each) for each in config.scene.filters] == [Recovery, Safety]
    assert [type(each) for each in config.training_scene.filters] == [Safety]


def test_a_wrong_patience_is_refused():
    with pytest.raises(InputError, match="patience must be above 0 s"):
        make_env("navigate", filters=[{"recovery": {"patience": 0.0}}])
