"""What moves in a world is what its file or a setting says, and what does not fit is named in one line."""

from __future__ import annotations

import pytest

from tb2rl.core.errors import InputError
from tb2rl.worlds.description import world_from, write_description
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles, find_dynamic_obstacles
from tb2rl.worlds.registry import find_world

HALL = {"start": [0, 0, 0], "bounds": [-5, -5, 5, 5]}
PATH = {"posts": 1, "path": [[0, 1], [3, 1]]}


def test_a_mapping_means_one_group_and_a_list_several():
    assert find_dynamic_obstacles(None, "dynamic_obstacles") == ()
    assert find_dynamic_obstacles({"people": 4}, "dynamic_obstacles") == (DynamicObstacles(people=4),)
    both = find_dynamic_obstacles(
        [{"people": 4, "speed": 1}, {"boxes": 2, "size": [1, 0.5], **PATH, "closed": True}], "dynamic_obstacles"
    )
    assert both[0] == DynamicObstacles(people=4, speed=(1.0, 1.0))
    assert (both[1].count, both[1].route) == (3, ((0.0, 1.0), (3.0, 1.0), (0.0, 1.0)))


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ({}, "dynamic_obstacles: must say how many people, posts or boxes"),
        ({"people": 0}, "dynamic_obstacles: must say how many people, posts or boxes"),
        ("people", "dynamic_obstacles: must say how many of what, such as {people: 4}"),
        (4, "dynamic_obstacles: must say how many of what, such as {people: 4}"),
        ([{"people": 1}, 3], "dynamic_obstacles: must say how many of what, such as {people: 4}"),
        ({"peeple": 4}, "unknown key of dynamic_obstacles 'peeple'; did you mean 'people'"),
        ({"people": -1}, "dynamic_obstacles.people: "),
        ({"people": 1.5}, "dynamic_obstacles.people: "),
        ({"posts": 51}, "dynamic_obstacles.posts: "),
        ([{"posts": 30}, {"people": 30}], "dynamic_obstacles: must be at most 50 movers, got 60"),
        ([{"people": 1}] * 51, "dynamic_obstacles: must be at most 50 entries, got 51"),
        ({"people": 1, "speed": 0}, "dynamic_obstacles.speed"),
        ({"people": 1, "speed": 1e-310}, "dynamic_obstacles.speed"),
        ({"people": 1, "speed": [1, 0.5]}, "dynamic_obstacles.speed: must be a number, or the lowest and the highest"),
        ({"people": 1, "speed": float("nan")}, "dynamic_obstacles.speed"),
        ({"posts": 1, "radius": 0}, "dynamic_obstacles.radius"),
        ({"posts": 1, "radius": 1e-300}, "dynamic_obstacles.radius"),
        ({"boxes": 1, "size": [1]}, "dynamic_obstacles.size"),
        ({"boxes": 1, "size": [1, 5e-324]}, "dynamic_obstacles.size"),
        ({"posts": 1, "path": [[0, 0], [1e300, 0]]}, "dynamic_obstacles.path"),
        ({"posts": 1, "path": [[0, 0], [1, 0]] * 501}, "dynamic_obstacles.path"),
        ({"posts": 1, "path": [[0, 0]]}, "dynamic_obstacles.path"),
        ({"posts": 1, "path": [[0, 0], [0, 0]]}, "dynamic_obstacles: a path must have two different points"),
        ({"people": 1, "path": [[0, 0], [1, 0]]}, "dynamic_obstacles: people follow no path"),
        ({"posts": 1, "closed": True}, "dynamic_obstacles: closed is of a path, and there is none"),
        ({"posts": 1, "avoid_robot": True}, "dynamic_obstacles: avoid_robot is of people, and there are none"),
    ],
    ids=lambda value: str(value)[:60],
)
def test_what_does_not_fit_is_named_in_one_line(setting, says):
    with pytest.raises(InputError) as caught:
        find_dynamic_obstacles(setting, "dynamic_obstacles")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_may_say_what_moves_and_one_that_is_wrong_says_so():
    assert world_from({**HALL, "dynamic_obstacles": [PATH, {"people": 2}]}, "hall").dynamic_obstacles[
        1
    ] == DynamicObstacles(people=2)
    assert world_from({**HALL, "dynamic_obstacles": PATH}, "hall").dynamic_obstacles[0].posts == 1
    assert world_from(HALL, "hall").dynamic_obstacles == ()
    with pytest.raises(InputError, match=r"world hall: movers: must say how many people"):
        world_from({**HALL, "dynamic_obstacles": {"radius": 1}}, "hall")


def test_what_moves_is_written_and_read_again(tmp_path):
    world = world_from(
        {**HALL, "dynamic_obstacles": [PATH, {"people": 2, "speed": [0.5, 0.7], "avoid_robot": True}]}, "hall"
    )
    write_description(world, tmp_path / "hall.yaml")
    assert find_world(str(tmp_path / "hall.yaml")).dynamic_obstacles == world.dynamic_obstacles


def test_a_world_with_other_places_has_the_same_movers():
    world = world_from({**HALL, "dynamic_obstacles": PATH}, "hall")
    assert world.with_places((1.0, 1.0, 0.0), None).dynamic_obstacles == world.dynamic_obstacles
