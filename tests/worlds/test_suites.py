"""Suites: frozen worlds with paths that are worth driving, and the worlds of BARN."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds import suites
from tb2rl.worlds.generators import FAMILIES
from tb2rl.worlds.suites import MIN_PATH_LENGTH, ROBOT_RADIUS, Suite, barn, find_suite, unknown_floors, unseen
from tb2rl.worlds.world import World

FIRST = "d8e0aa0035ccef4f5118e40e9c02adf0d997ae03fc9a5e4ffcccd245ed65df2c"  # of five worlds
FIRST_UNKNOWN = "8067c3fb0d77c5e3b62ff87b1c1133c82eb196a0b695fe46aa321b1bc412f500"  # of three floors
UNKNOWN_DIGEST = "1b7b8955985786c4e16387a549b4dba30770cb1f57e72034c5d1918d2770d4d1"
DIGEST = "edf133da02086c2c9c181ef4e1c84501f5f628353e42b8378965b010b006f725"


@pytest.mark.slow
def test_the_suite_is_frozen_and_every_path_is_worth_driving_and_can_be_driven():
    """A changed generator needs another name for the suite, because earlier results could not be compared."""
    suite = find_suite("unseen")
    assert suite.digest == DIGEST
    assert [suite.families.count(maker.__name__) for maker in FAMILIES] == [200] * 5
    assert ROBOT.radius == ROBOT_RADIUS
    assert min(suite.path_lengths) >= MIN_PATH_LENGTH == 4.0
    assert max(suite.path_lengths) < ROBOT.max_speed * suite.time_limit / 2, "half the top speed is enough for each"
    for world, length in zip(suite.worlds, suite.path_lengths, strict=True):
        assert math.dist(world.start[:2], world.goal[:2]) <= 1.02 * length
        assert world.clearance(*world.start[:2]) >= 0.25 - 1e-6
        assert world.clearance(*world.goal[:2]) >= 0.3 - 1e-6
    for world in suite.worlds[:5]:  # one of each family, by exact geometry
        assert world.free_space(ROBOT_RADIUS - 0.01).covers(shapely.MultiPoint([world.start[:2], world.goal[:2]]))


def test_the_first_worlds_of_the_suites_are_frozen(monkeypatch):
    monkeypatch.setattr(suites, "_UNSEEN", replace(suites._UNSEEN, worlds=5))
    assert unseen.__wrapped__().digest == FIRST
    monkeypatch.setattr(suites, "_NUM_UNKNOWN", 3)
    assert unknown_floors.__wrapped__().digest == FIRST_UNKNOWN


@pytest.mark.slow
def test_unknown_floors_are_frozen_and_a_third_of_the_ways_are_detours():
    suite = find_suite("unknown")
    assert suite.digest == UNKNOWN_DIGEST
    assert [suite.families.count(name) for name in ("offices", "tunnels")] == [150] * 2
    lengths, limits = np.array(suite.path_lengths), np.array(suite.time_limits)
    straight = np.array([math.dist(world.start[:2], world.goal[:2]) for world in suite.worlds])
    assert lengths.min() >= 15.0
    assert (lengths >= 1.5 * straight).mean() > 1 / 3
    assert limits == pytest.approx(4 * lengths / 0.55)
    assert suite.time_limit == limits.max()


def tiny(**changed) -> Suite:
    box, post, bounds = (1.0, 2.0, 0.5, 0.5, 0.3), (-1.0, 0.5, 0.1), (-3.0, -3.0, 3.0, 3.0)
    world = World.from_shapes("tiny", [box], [post], start=(0.0, 0.0, 0.0), goal=(2.0, 0.0, 0.0), bounds=bounds)
    return Suite("tiny", (replace(world, **changed),), ("one",), (2.0,), 10.0)


def test_a_digest_depends_on_a_hundredth_of_a_millimetre_and_not_on_rounding():
    world = tiny().worlds[0]
    changes = {"boxes": world.boxes + 1e-5, "posts": world.posts + 1e-5, "start": (1e-5, 0, 0), "goal": (2, 1e-5, 0)}
    assert len({tiny(**{name: value}).digest for name, value in changes.items()} | {tiny().digest}) == 5
    assert tiny(posts=world.posts + 1e-9, start=(-1e-9, 0.0, 0.0)).digest == tiny().digest
    assert (
        replace(tiny(), reference_lengths=(2.0,)).digest
        != replace(tiny(), reference_lengths=(2.1,)).digest
        != tiny().digest
    )


def yard(*more: tuple[float, float]) -> np.ndarray:
    """Posts of a yard as in BARN, closed on three sides, shape (n, 3), float32."""
    sides = [(x, 0.075 + 0.15 * k) for x in (-4.425, -0.075) for k in range(64)]
    places = np.array([*sides, *((-4.425 + 0.15 * k, 0.075) for k in range(30)), *more])
    return np.column_stack([places, np.full(len(places), 0.075)]).astype(np.float32)


STRAIGHT = np.column_stack([np.full(30, 14), np.arange(30)])  # x = -2.325 all along, y from 5.175 to 9.525
ARRAYS = {"posts_4": yard((-2.25, 6.0)), "path_4": STRAIGHT, "posts_12": yard(), "path_12": STRAIGHT[::2]}


def saved(folder: Path, **arrays) -> Path:
    np.savez(folder / "worlds.npz", **arrays)
    return folder / "worlds.npz"


def test_worlds_of_barn_have_its_rules_and_its_reference_paths(tmp_path):
    suite = find_suite("barn", saved(tmp_path, **ARRAYS, about=np.zeros(1)))
    assert [world.name for world in suite.worlds] == ["barn 4", "barn 12"]
    assert (suite.name, suite.goal_radius, suite.time_limit) == ("barn", 1.0, 100.0)
    for world in suite.worlds:
        assert (world.start, world.goal[:2]) == ((-2.25, 3.0, 1.57), (-2.25, 13.0))
        assert shapely.box(*world.bounds).covers(shapely.MultiPoint([world.start[:2], world.goal[:2]]).buffer(1.5))
    path = [(-2.25, 3.0), (-2.325, 5.175), (-2.325, 9.525), (-2.25, 13.0)]
    assert suite.reference_lengths[0] == pytest.approx(sum(math.dist(*pair) for pair in pairwise(path)))
    assert suite.path_lengths[1] == pytest.approx(10.0, abs=0.15)
    assert suite.path_lengths[0] > suite.path_lengths[1], "round a post"


POST = (
    "<model name='post_{}'><pose frame=''>{} {} 0.5 0 0 0</pose><link name='l'><collision name='c'><geometry>"
    "<cylinder><radius>{}</radius><length>1</length></cylinder></geometry></collision></link></model>"
)


@pytest.mark.parametrize(("place", "worlds"), [("", "world_files"), ("jackal_helper/worlds/BARN", "")])
def test_a_copy_of_the_repository_has_the_same_worlds(place, worlds, tmp_path):
    folder = tmp_path / "copy" / place
    (folder / "path_files").mkdir(parents=True)
    (folder / worlds).mkdir(exist_ok=True)
    for number in (4, 12):
        np.save(folder / "path_files" / f"path_{number}.npy", ARRAYS[f"path_{number}"])
        posts = "".join(POST.format(k, *post) for k, post in enumerate(ARRAYS[f"posts_{number}"].tolist()))
        text = f"<sdf version='1.6'><world name='default'>{posts}</world></sdf>"
        (folder / worlds / f"world_{number}.world").write_text(text)
    copy, archive = barn(tmp_path / "copy"), barn(saved(tmp_path, **ARRAYS))
    assert ([world.name for world in copy.worlds], copy.reference_lengths) == (
        ["barn 4", "barn 12"],
        archive.reference_lengths,
    )
    assert copy.path_lengths == pytest.approx(archive.path_lengths, abs=1e-3)
    (folder / "path_files" / "path_4.npy").unlink()
    with pytest.raises(InputError, match=r"cannot read .*path_4.npy"):
        barn(tmp_path / "copy")


WALL = yard(*((-4.425 + 0.15 * k, 9.0) for k in range(30)))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"path_1": STRAIGHT}, "no worlds of BARN"),
        ({"posts_1": yard()}, "path_1 is not a file"),
        ({"posts_1": yard()[:, :2], "path_1": STRAIGHT}, "post 0 .* must be 3 numbers"),
        ({"posts_1": yard(), "path_1": STRAIGHT * np.nan}, "a reference path has a NaN"),
        ({"posts_1": np.array([{}]), "path_1": STRAIGHT}, "cannot read worlds of BARN .* Object arrays"),
        ({"posts_1": yard((-2.25, 13.0)), "path_1": STRAIGHT}, "goal .* inside an obstacle"),
        ({"posts_1": WALL, "path_1": STRAIGHT}, "barn 1 has no path"),
    ],
)
def test_a_bad_archive_is_refused_in_one_line(arrays, message, tmp_path):
    with pytest.raises(InputError, match=message) as refused:
        barn(saved(tmp_path, **arrays))
    assert "\n" not in str(refused.value)


def test_a_file_that_is_no_archive_and_an_unknown_suite_are_refused(tmp_path):
    whole = saved(tmp_path, **ARRAYS).read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    for name in ("half.npz", "missing.npz", 300 * "x"):
        with pytest.raises(InputError, match="cannot read worlds of BARN"):
            barn(tmp_path / name)
    with pytest.raises(InputError, match="no folder path_files"):
        barn(tmp_path)
    mistakes = (("unsen", None, "mean 'unseen'"), ("barn", None, "barn PATH"), ("unseen", tmp_path, "barn PATH"))
    for name, path, words in mistakes:
        with pytest.raises(InputError, match=words):
            find_suite(name, path)
