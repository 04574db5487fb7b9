"""Start poses in many worlds: reachable, with room around, and independent of other environments."""

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds import World
from tb2rl.worlds.floor import PoseSampler
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings, generate
from tb2rl.worlds.registry import find_world

WORLDS = generate(GeneratorSettings("mixed", worlds=5, difficulty=(1.0, 1.0)), GENERATORS["mixed"], "training")


def poses_in(worlds, chosen, clearance=0.25):
    random = np.random.default_rng(0).random((len(chosen), 4))
    random[0], random[1:2] = 0.0, np.nextafter(1.0, 0.0)  # the ends of the random numbers
    return PoseSampler(worlds, ROBOT.radius).sample_poses(np.array(chosen), random, clearance)


def test_poses_have_room_and_can_be_reached_even_through_narrow_doors():
    chosen = np.arange(300) % 5
    poses = poses_in(WORLDS, chosen, 0.5)
    for number, world in enumerate(WORLDS):
        here = poses[chosen == number]
        assert min(world.clearance(x, y) for x, y, _ in here) >= 0.5 - 1e-6
        assert world.free_space(0.17).covers(shapely.MultiPoint(here[:, :2]))
    assert (np.abs(poses[:, 2]) <= np.pi).all()
    poses = poses_in(WORLDS, [1] * 2000, 0.3)  # exact free spaces end where the clearance of a start does
    x, y = ((poses[:, axis] // (8.0 / 3)).astype(int) for axis in (0, 1))
    assert len(set(zip(x.tolist(), y.tolist(), strict=True))) == 9, "in all rooms"
    assert WORLDS[1].free_space(0.3).area < 8.0


def test_poses_are_spread_evenly_over_the_free_space():
    loop = find_world("loop")
    poses = poses_in((loop, loop), [1] * 20_000, 0.6)
    free, quarter = loop.free_space(0.6), shapely.box(0.0, 0.0, 5.0, 5.0)
    inside = (poses[:, :2] > 0).all(axis=1).mean()
    assert inside == pytest.approx(free.intersection(quarter).area / free.area, abs=0.015)


def test_a_pose_follows_from_its_world_and_numbers_alone():
    random, chosen = np.random.default_rng(1).random((20, 4)), np.arange(20)[::-1] % 5
    together = PoseSampler(WORLDS, ROBOT.radius).sample_poses(chosen, random, 0.25)
    others = PoseSampler(WORLDS, ROBOT.radius)  # which meets the worlds one by one, and in another order
    alone = [others.sample_poses(chosen[i : i + 1], random[i : i + 1], 0.25)[0] for i in range(19, -1, -1)]
    assert (together == np.array(alone)[::-1]).all()


def test_a_world_with_too_many_cells_is_refused():
    far = World.from_shapes("far", [(0, 0, 1, 1, 0), (3e3, 3e3, 1, 1, 0)], start=(5, 5, 0))
    with pytest.raises(InputError, match=r"world far: .* have more than 4000000 cells of 0.1 m; set bounds"):
        poses_in((far, find_world("loop")), [0])
