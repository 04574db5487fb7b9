"""When the robot drives, when it stands, and the reasons that the driver reports."""

import math

import numpy as np
import pytest

from tb2rl.deploy import Driver, Filter, Finding, SpeedLimits

PERIOD = 0.2
ORIGIN, AT_REST = (0.0, 0.0, 0.0), (0.0, 0.0)


@pytest.fixture
def scan(scan_of):
    return scan_of(np.full(181, 2.0))


@pytest.fixture
def started(scripted_policy, scan):
    """A function that makes a policy, and a driver that has started and has a scan and odometry of time 0."""

    def make(limits=None, dry_run=False, filters=(), **needs):
        policy = scripted_policy(**needs)
        policy.filters = filters
        driver = Driver(policy, limits, dry_run=dry_run)
        driver.see_scan(scan, 0.0)
        driver.see_odometry(ORIGIN, AT_REST, 0.0)
        driver.start()
        return policy, driver

    return make


def reason_to_stand(driver, now):
    command = driver.command(now)
    assert (command.v, command.w) == (0.0, 0.0)
    return command.why


def test_the_robot_stands_until_start_and_all_data_and_after_a_stop_or_contact(scripted_policy, scan):
    policy = scripted_policy(goal="plan")
    driver = Driver(policy)
    for step, reason in (
        (driver.start, "not started"),
        (lambda: driver.see_scan(scan, 0.0), "no scan has arrived yet"),
        (lambda: driver.see_odometry(ORIGIN, AT_REST, 0.0), "no odometry has arrived yet"),
        (lambda: driver.set_goal((3.0, 0.0)), "no goal has arrived yet"),
        (lambda: driver.set_plan([[0.0, 0.0], [3.0, 0.0]]), "no plan has arrived yet"),
    ):
        assert reason_to_stand(driver, 0.0) == reason
        step()
    command = driver.command(0.1)
    assert (command.v, command.w, command.why) == (0.4, 0.2, "driving")
    for stop, reason in ((driver.stop, "told to stop"), (driver.bump, "the bumper was touched")):
        stop()
        assert reason_to_stand(driver, 0.2) == reason
        driver.start()
        assert driver.command(0.3).why == "driving"
    assert [len(episode) for episode in policy.episodes] == [1, 1, 1]


def test_the_robot_stands_while_data_is_stale_and_then_starts_a_new_episode(started, scan):
    policy, driver = started(uses_odometry=True)
    for now in np.arange(0.0, 0.5, 0.1):
        assert driver.command(now).why == "driving"
    assert reason_to_stand(driver, 0.51) == "the last scan is 0.5 s old"
    driver.see_scan(scan, 0.6)
    for wrong in (math.nan, math.inf, 1e200):
        assert not driver.see_odometry((0.0, 0.0, wrong), AT_REST, 0.6)
        assert not driver.see_odometry(ORIGIN, (wrong, 0.0), 0.6)
    assert reason_to_stand(driver, 0.6) == "the last odometry is 0.6 s old"
    driver.see_odometry(ORIGIN, AT_REST, 0.6)
    assert driver.command(0.7).why == "driving"
    assert [len(episode) for episode in policy.episodes] == [3, 1]
    assert reason_to_stand(driver, -0.4) == "the last scan is stamped 1.0 s ahead: synchronise the clocks"
    assert reason_to_stand(driver, math.nan) == "the last scan is nan s old"
    assert reason_to_stand(driver, 1.8e9).startswith("the last scan has the time of another clock; ")


def test_the_robot_stops_at_its_goal_and_drives_on_to_another(started, scan):
    policy, driver = started(goal="goal", goal_radius=0.3)
    driver.set_goal((0.5, 0.0))
    assert driver.command(0.0).why == "driving"
    driver.see_odometry((0.25, 0.0, 0.0), (0.4, 0.0), 0.1)
    assert reason_to_stand(driver, 0.1) == "the goal is reached"
    driver.see_odometry((0.15, 0.0, 0.0), AT_REST, 0.2)  # it rolled back a little
    assert reason_to_stand(driver, 0.2) == "the goal is reached"
    for now, goal in enumerate([(2.0, 1.0), (2.1, 1.0), (-2.0, 1.0)]):  # the second is the first, better known
        driver.see_scan(scan, now)
        driver.see_odometry(ORIGIN, AT_REST, now)
        driver.set_goal(goal)
        assert driver.command(now).why == "driving"
        assert policy.episodes[-1][-1].goal == goal
    assert [len(episode) for episode in policy.episodes] == [1, 2, 1]


def test_the_policy_decides_once_per_control_step_also_after_the_clock_was_set_back(started, scan):
    policy, driver = started()
    for now in np.arange(0.0, 2.0, 0.02):
        driver.see_scan(scan, now)
        driver.command(now + 0.005 * math.sin(50.0 * now))
    assert len(policy.episodes[0]) == 10
    driver.see_scan(scan, -5.0)
    assert driver.command(-5.0).why == "driving"
    assert len(policy.episodes[0]) == 11
    assert driver.preflight() == []


def test_the_policy_gets_the_latest_data_and_the_last_command(started, scan_of):
    policy, driver = started(uses_odometry=True)
    driver.see_scan(scan_of(np.full(181, 3.0)), 0.1)
    driver.see_odometry((1.0, 2.0, 3.0), (0.3, -0.1), 0.1)
    for now in (0.1, 0.3):
        driver.command(now)
    first, second = policy.episodes[0]
    assert first.ranges == pytest.approx(3.0, abs=0.01)
    assert (first.pose, first.twist, first.goal, first.waypoint) == ((1.0, 2.0, 3.0), (0.3, -0.1), None, None)
    assert (first.command, second.command) == ((0.0, 0.0), (0.4, 0.2))


def test_the_policy_gets_the_lookahead_point_of_a_plan(started):
    policy, driver = started(goal="plan", lookahead=1.5)
    driver.set_plan([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]])
    for step, pose in enumerate([(0.0, 0.2, 0.0), (1.0, -0.1, 0.0), (2.1, 1.5, 0.0)]):
        driver.see_odometry(pose, AT_REST, step * PERIOD)
        driver.command(step * PERIOD)
    assert [sensed.waypoint for sensed in policy.episodes[0]] == [(1.5, 0.0), (2.0, 0.5), (2.0, 2.0)]
    assert policy.episodes[0][0].goal == (2.0, 2.0)


def test_a_command_above_the_limits_is_slowed_down_on_the_same_arc(started):
    policy, driver = started(SpeedLimits(speed=0.2, turn_rate=1.0))
    policy.speeds = 0.5, 0.6
    command = driver.command(0.0)
    assert (command.v, command.w) == pytest.approx((0.2, 0.24))
    policy.speeds = -0.1, -4.0
    command = driver.command(PERIOD)
    assert (command.v, command.w) == pytest.approx((-0.025, -1.0))
    assert policy.episodes[0][1].command == pytest.approx((0.2, 0.24))
    for speed, turn_rate, v, w in np.random.default_rng(0).uniform(0.1, 5.0, (500, 4)):  # not even by rounding
        assert (np.abs(SpeedLimits(speed, turn_rate)(np.array([[v, -w]]))) <= (speed, turn_rate)).all()


def test_filters_run_before_the_limits_and_start_anew_with_each_episode(started):
    class SlowerEachStep(Filter):
        def reset(self, num_envs):
            self.steps = np.zeros((num_envs, 1))

        def __call__(self, commands, robot_state):
            assert (robot_state.ranges.shape, robot_state.twist.shape) == ((1, 37), (1, 2))
            self.steps += 1.0
            return commands / self.steps

    policy, driver = started(SpeedLimits(speed=0.3), filters=[SlowerEachStep()])
    policy.speeds = 0.8, 0.0
    assert [driver.command(step * PERIOD).v for step in range(3)] == pytest.approx([0.3, 0.3, 0.8 / 3])
    driver.start()
    assert driver.command(2 * PERIOD).v == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda driver: driver.set_goal((0.0, 1e200)), "the goal has a number that is not finite"),
        (lambda driver: driver.set_plan([]), "a plan has"),
        (lambda driver: driver.set_plan([[math.nan, 0.0]]), "a plan has"),
    ],
)
def test_goals_and_plans_that_are_not_valid_are_refused(call, message, started):
    _, driver = started(goal="plan")
    with pytest.raises(ValueError, match=message):
        call(driver)


def test_a_dry_run_reports_the_command_and_stands(started):
    policy, driver = started(dry_run=True)
    command = driver.command(0.0)
    assert (command.v, command.w, command.why, command.wanted) == (0.0, 0.0, "dry run", (0.4, 0.2))
    driver.command(PERIOD)
    assert policy.episodes[0][1].command == (0.0, 0.0)
    policy.speeds = math.nan, 0.0
    assert (
        reason_to_stand(driver, 2 * PERIOD) == "the policy or a filter returned nan and 0.0 in place of finite speeds"
    )


def test_the_preflight_check_finds_all_that_does_not_fit(scripted_policy, scan_of):
    driver = Driver(scripted_policy(goal="plan"), SpeedLimits(speed=0.22))
    serious = [finding.message for finding in driver.preflight() if finding.is_error]
    assert serious == [f"no {name} has arrived yet" for name in ("scan", "odometry", "goal", "plan")]
    for number in range(5):
        driver.see_scan(scan_of(np.ones(61), math.radians(60), range_min=0.45, range_max=3.5), 0.3 * number)
    driver.see_odometry(ORIGIN, AT_REST, 0.0)
    driver.set_plan([[3.0, 0.0]])
    driver.start()
    narrow, *others = driver.preflight()
    assert narrow.is_error
    assert narrow.message.startswith("the scan covers 60 degrees (-30 to 30), the policy was trained with 180 degrees")
    driver.see_odometry(ORIGIN, AT_REST, 1.2)
    assert reason_to_stand(driver, 1.2) == narrow.message
    assert [finding.is_error for finding in others] == [False] * 4
    assert [finding.message for finding in others] == [
        "a scan arrives every 0.3 s, but the policy decides every 0.2 s",
        "beyond 3.5 m the scanner sees no walls; the policy was trained with 30 m",
        "the scanner sees nothing nearer than 0.45 m",
        "the policy's 0.5 m/s are limited to 0.22 m/s",
    ]
    driver = Driver(scripted_policy())
    for number in range(3):
        driver.see_scan(scan_of(np.ones(181)), 0.6 * number)
    rare = "a scan arrives every 0.6 s, but the robot stops after 0.5 s without one"
    assert driver.preflight() == [Finding(rare, True)]
