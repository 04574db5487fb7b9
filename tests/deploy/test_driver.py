"""When the robot drives, when it stands, and what it says then."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tb2rl.deploy import Driver, Limits, Mounting

PERIOD = 0.2


@pytest.fixture
def scan(scan_of):
    """A scan of a wall all around."""
    return scan_of(np.full(181, 2.0))


@pytest.fixture
def drives(told, scan):
    """A function that makes a policy, and a driver that has started and seen a scan and odometry at time 0."""

    def make(limits=None, planner=None, dry_run=False, **needs):
        policy = told(**needs)
        driver = Driver(policy, limits, planner=planner, dry_run=dry_run)
        driver.see_scan(scan, 0.0)
        driver.see_odometry((0.0, 0.0, 0.0), (0.0, 0.0), 0.0)
        driver.start()
        return policy, driver

    return make


def stands(driver, now):
    """Why it stands."""
    command = driver.command(now)
    assert (command.v, command.w) == (0.0, 0.0)
    return command.why


def test_it_stands_until_it_is_started_and_when_it_is_told_to(told, scan):
    driver = Driver(told())
    driver.see_scan(scan, 0.0)
    assert stands(driver, 0.0) == "not started"
    driver.start()
    command = driver.command(0.1)
    assert (command.v, command.w, command.why) == (0.4, 0.2, "driving")
    driver.stop()
    assert stands(driver, 0.2) == "told to stop"
    driver.start()
    assert driver.command(0.3).why == "driving"


def test_it_waits_for_what_the_policy_needs(told, scan):
    driver = Driver(told(goal="plan"))
    driver.start()
    assert stands(driver, 0.0) == "waiting for a scan"
    driver.see_scan(scan, 0.0)
    assert stands(driver, 0.0) == "waiting for odometry"
    driver.see_odometry((0.0, 0.0, 0.0), (0.0, 0.0), 0.0)
    assert stands(driver, 0.0) == "waiting for a goal"
    driver.set_goal((3.0, 0.0))
    assert stands(driver, 0.0) == "waiting for a plan"
    driver.set_plan([[0.0, 0.0], [3.0, 0.0]])
    assert driver.command(0.0).why == "driving"


def test_it_stands_while_data_is_stale_and_then_begins_anew(drives, scan):
    policy, driver = drives(uses_odometry=True)
    for now in np.arange(0.0, 0.5, 0.1):
        assert driver.command(now).why == "driving"
    assert stands(driver, 0.51) == "the last scan is 0.5 s old"
    driver.see_scan(scan, 0.6)
    assert stands(driver, 0.6) == "the last odometry is 0.6 s old"
    driver.see_odometry((0.0, 0.0, 0.0), (0.0, 0.0), 0.6)
    assert driver.command(0.7).why == "driving"
    assert [len(episode) for episode in policy.episodes] == [3, 1]
    assert stands(driver, -0.4) == "the last scan is stamped 1.0 s ahead: the clocks differ"


def test_a_touch_of_the_bumper_stops_it_until_the_next_start(drives):
    policy, driver = drives()
    driver.command(0.0)
    driver.bump()
    assert stands(driver, 0.1) == "the bumper was touched"
    driver.start()
    assert driver.command(0.2).why == "driving"
    assert [len(episode) for episode in policy.episodes] == [1, 1]


def test_it_stops_at_the_goal_and_goes_on_to_another(drives, scan):
    policy, driver = drives(goal="goal", goal_radius=0.3)
    driver.set_goal((0.5, 0.0))
    assert driver.command(0.0).why == "driving"
    driver.see_odometry((0.25, 0.0, 0.0), (0.4, 0.0), 0.1)
    assert stands(driver, 0.1) == "the goal is reached"
    driver.see_odometry((0.15, 0.0, 0.0), (0.0, 0.0), 0.2)  # it rolled back a little
    assert stands(driver, 0.2) == "the goal is reached"
    for now, goal in enumerate([(2.0, 1.0), (2.1, 1.0), (-2.0, 1.0)]):  # the second is the first, better known
        driver.see_scan(scan, now)
        driver.see_odometry((0.0, 0.0, 0.0), (0.0, 0.0), now)
        driver.set_goal(goal)
        assert driver.command(now).why == "driving"
        assert policy.episodes[-1][-1].goal == goal
    assert [len(episode) for episode in policy.episodes] == [1, 2, 1]


def test_the_policy_decides_once_in_a_control_step_however_often_it_is_asked(drives, scan):
    policy, driver = drives()
    for now in np.arange(0.0, 2.0, 0.02):
        driver.see_scan(scan, now)
        driver.command(now + 0.005 * math.sin(50.0 * now))
    assert len(policy.episodes[0]) == 10


def test_after_the_clock_was_set_back_it_goes_on(drives, scan):
    policy, driver = drives()
    driver.see_scan(scan, 1000.0)
    driver.command(1000.0)
    driver.see_scan(scan, 1.0)
    assert driver.command(1.0).why == "driving"
    assert len(policy.episodes[0]) == 2
    assert driver.preflight() == []


def test_the_policy_senses_what_came_in_and_what_the_robot_was_told(drives, scan_of):
    policy, driver = drives(uses_odometry=True)
    driver.see_scan(scan_of(np.full(181, 3.0)), 0.1)
    driver.see_odometry((1.0, 2.0, 3.0), (0.3, -0.1), 0.1)
    for now in (0.1, 0.3):
        driver.command(now)
    first, second = policy.episodes[0]
    assert first.ranges == pytest.approx(3.0, abs=0.01)
    assert (first.pose, first.twist, first.goal, first.waypoint) == ((1.0, 2.0, 3.0), (0.3, -0.1), None, None)
    assert (first.command, second.command) == ((0.0, 0.0), (0.4, 0.2))


def test_what_is_too_fast_is_slowed_down_on_the_same_arc(drives):
    policy, driver = drives(Limits(speed=0.2, turn_rate=1.0))
    policy.speeds = 0.5, 0.6
    command = driver.command(0.0)
    assert (command.v, command.w) == pytest.approx((0.2, 0.24))
    policy.speeds = -0.1, -4.0
    command = driver.command(PERIOD)
    assert (command.v, command.w) == pytest.approx((-0.025, -1.0))
    assert policy.episodes[0][1].command == pytest.approx((0.2, 0.24))


@pytest.mark.parametrize("name", ["speed", "turn_rate"])
@pytest.mark.parametrize("value", [-5.0, 0.0, math.nan])
def test_a_limit_is_a_number_above_0(name, value):
    with pytest.raises(ValueError, match=f"{name} takes .* above 0"):
        Limits(**{name: value})


def test_no_speed_is_above_its_limit_not_even_by_rounding(drives):
    rng = np.random.default_rng(0)
    for speed, turn_rate, v, w in rng.uniform(0.1, 5.0, (2000, 4)):
        slowed = Limits(speed, turn_rate).slowed(v, -w)
        assert abs(slowed[0]) <= speed
        assert abs(slowed[1]) <= turn_rate


@pytest.mark.parametrize("where", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)])
def test_a_mounting_has_finite_numbers(where):
    with pytest.raises(ValueError, match="finite"):
        Mounting(*where)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1e200])
@pytest.mark.parametrize("place", range(5))
def test_odometry_that_is_no_number_is_as_good_as_none(drives, scan, wrong, place):
    _, driver = drives(uses_odometry=True)
    numbers = [0.0] * 5
    numbers[place] = wrong
    driver.see_odometry(tuple(numbers[:3]), tuple(numbers[3:]), 0.6)
    driver.see_scan(scan, 0.6)
    assert stands(driver, 0.6) == "the last odometry is 0.6 s old"


def test_a_time_that_is_no_number_is_no_time_to_drive(drives):
    _, driver = drives()
    assert stands(driver, math.nan) == "the last scan is nan s old"


@pytest.mark.parametrize("goal", [(math.nan, 0.0), (0.0, 1e200)])
def test_a_goal_that_is_no_place_is_refused(drives, goal):
    with pytest.raises(ValueError, match="a goal has a number that is not finite"):
        drives(goal="goal")[1].set_goal(goal)


def test_a_dry_run_says_what_it_would_drive(drives):
    policy, driver = drives(dry_run=True)
    command = driver.command(0.0)
    assert (command.v, command.w, command.why, command.wanted) == (0.0, 0.0, "dry run", (0.4, 0.2))
    driver.command(PERIOD)
    assert policy.episodes[0][1].command == (0.0, 0.0)


def test_no_robot_drives_by_a_scan_that_shows_too_little_nor_at_speeds_that_are_none(drives, scan_of):
    policy, driver = drives()
    driver.see_scan(scan_of(np.ones(61), field=math.radians(60)), 0.1)
    assert stands(driver, 0.1).startswith("the scan covers 60 degrees")
    driver.see_scan(scan_of(np.ones(181)), 0.2)
    policy.speeds = math.nan, 0.0
    assert stands(driver, 0.2) == "the policy gave no speeds, but nan and 0.0"


def test_a_plan_is_told_as_the_point_ahead_on_it(drives):
    policy, driver = drives(goal="plan", reach=1.5)
    driver.set_plan([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]])
    for step, pose in enumerate([(0.0, 0.2, 0.0), (1.0, -0.1, 0.0), (2.1, 1.5, 0.0)]):
        driver.see_odometry(pose, (0.0, 0.0), step * PERIOD)
        driver.command(step * PERIOD)
    assert [sensed.waypoint for sensed in policy.episodes[0]] == [(1.5, 0.0), (2.0, 0.5), (2.0, 2.0)]
    assert policy.episodes[0][0].goal == (2.0, 2.0)


@pytest.mark.parametrize("points", [[], [1.0, 2.0], [[1.0, 2.0, 3.0]], [[math.nan, 0.0]]])
def test_a_plan_that_is_none_is_refused(drives, points):
    with pytest.raises(ValueError, match="a planned way"):
        drives(goal="plan")[1].set_plan(points)


def test_a_planner_that_finds_no_way_lets_the_robot_stand(drives):
    class Lost:
        def ahead(self, pose, goal, reach):
            return None

    _, driver = drives(goal="plan", planner=Lost())
    driver.set_goal((3.0, 0.0))
    assert stands(driver, 0.0) == "the planner finds no way to the goal"


def test_the_preflight_check_says_all_that_does_not_fit(told, scan_of):
    driver = Driver(told(goal="plan"), Limits(speed=0.22))
    serious = [finding.sentence for finding in driver.preflight() if finding.serious]
    assert serious == [
        "no scan has come yet",
        "the policy needs odometry, and none has come yet",
        "the policy drives to a goal, and it was told none",
        "the policy follows a planned way, and there is neither a plan nor a planner",
    ]
    for number in range(5):
        driver.see_scan(scan_of(np.ones(61), math.radians(60), range_min=0.45, range_max=3.5), 0.3 * number)
    driver.see_odometry((0.0, 0.0, 0.0), (0.0, 0.0), 0.0)
    driver.set_plan([[3.0, 0.0]])
    findings = driver.preflight()
    assert [finding.serious for finding in findings] == [True, False, False, False, False]
    assert [finding.sentence for finding in findings] == [
        "the scan covers 60 degrees (-30 to 30), the policy was trained with 180 degrees (-90 to 90); "
        "so narrow a scan, as of a depth camera, is not enough",
        "a scan comes every 0.3 s, the policy decides every 0.2 s: at times by the same scan",
        "the scanner sees 3.5 m far, the policy was trained with 30 m: walls beyond look like open space",
        "the scanner sees nothing nearer than 0.45 m",
        "the policy drives up to 0.5 m/s; it is slowed to 0.22",
    ]


def test_a_scanner_that_is_too_slow_to_drive_by_is_found_before(told, scan_of):
    driver = Driver(told())
    for number in range(3):
        driver.see_scan(scan_of(np.ones(181)), 0.6 * number)
    (finding,) = driver.preflight()
    assert finding.serious
    assert finding.sentence == "a scan comes every 0.6 s, and the robot stops if it is 0.5 s old"
