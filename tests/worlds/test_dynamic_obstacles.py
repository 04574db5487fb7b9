"""Dynamic obstacles in a world's file or a setting, and mistakes in them."""

import pytest

from tb2rl.core.errors import InputError
from tb2rl.worlds.description import parse_world, write_description
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles, parse_dynamic_obstacles
from tb2rl.worlds.registry import find_world

PATH = {"posts": 1, "path": [[0, 1], [3, 1]]}


def test_a_mapping_means_one_group_and_a_list_several():
    assert parse_dynamic_obstacles(None, "x") == ()
    assert parse_dynamic_obstacles({"people": 4}, "x") == (DynamicObstacles(people=4),)
    closed = {"boxes": 2, "size": [1, 0.5], **PATH, "closed": True}
    people, along = parse_dynamic_obstacles([{"people": 4, "speed": 1}, closed], "x")
    assert people == DynamicObstacles(people=4, speed=(1.0, 1.0))
    assert (along.count, along.route) == (3, ((0.0, 1.0), (3.0, 1.0), (0.0, 1.0)))


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({}, "x: needs a number of people, posts or boxes"),
        ("people", "x: expected a mapping of keys to values, got 'people'"),
        ({"peeple": 4}, "unknown key of x 'peeple'; did you mean 'people'"),
        ([{"posts": 30}, {"people": 30}], "x: must be at most 50 dynamic obstacles, got 60"),
        ({"posts": 1, "path": [[0, 0], [0, 0]]}, "x: a path must have two different points"),
        ({"posts": 1, "closed": True}, "x: closed needs a path, and there is none"),
    ],
)
def test_a_mistake_is_one_line(setting, message):
    with pytest.raises(InputError) as caught:
        parse_dynamic_obstacles(setting, "x")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_may_have_dynamic_obstacles_which_are_written_and_read_again(tmp_path):
    groups = [PATH, {"people": 2, "speed": [0.5, 0.7], "avoid_robot": True}]
    world = parse_world({"start": [0, 0, 0], "bounds": [-5, -5, 5, 5], "dynamic_obstacles": groups}, "hall")
    assert [group.count for group in world.dynamic_obstacles] == [1, 2]
    write_description(world, tmp_path / "hall.yaml")
    assert find_world(str(tmp_path / "hall.yaml")).dynamic_obstacles == world.dynamic_obstacles
    assert world.with_changes((1.0, 1.0, 0.0), None).dynamic_obstacles == world.dynamic_obstacles
