"""A training as the 2018 tutorial's: its calls in its order, against a robot in Gazebo, or what says that it is one.

    tutorial.py EPISODES STEPS SECONDS    # of wall-clock time that an action lasts: 0.2 there

It is written from the list of what the tutorial's programs and `openai_ros` call, and imports nothing of ours.
"""

from __future__ import annotations

import json
import random
import sys
import time

import rospy
from controller_manager_msgs.srv import SwitchController  # noqa: F401 (the tutorial's programs import it)
from gazebo_msgs.msg import ODEPhysics  # noqa: F401 (and this)
from gazebo_msgs.srv import SetPhysicsProperties
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from openai_ros.msg import RLExperimentInfo
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Empty

ACTIONS = ((0.5, 0.0), (0.05, 0.3), (0.05, -0.3))  # forward, left, right: v [m/s], w [rad/s]
KEPT, FARTHEST, COLLISION = 144, 6, 0.5  # every so many readings; [m]; [m]
ALPHA, GAMMA, EPSILON = 0.1, 0.7, 0.9


class Gazebo:
    """The services of the simulation."""

    def __init__(self):
        self.pause = rospy.ServiceProxy("/gazebo/pause_physics", Empty)
        self.unpause = rospy.ServiceProxy("/gazebo/unpause_physics", Empty)
        self.reset_simulation = rospy.ServiceProxy("/gazebo/reset_simulation", Empty)
        self.reset_world = rospy.ServiceProxy("/gazebo/reset_world", Empty)
        rospy.wait_for_service("/gazebo/set_physics_properties")
        self.set_physics = rospy.ServiceProxy("/gazebo/set_physics_properties", SetPhysicsProperties)
        for service in ("pause_physics", "unpause_physics", "reset_simulation", "reset_world"):
            rospy.wait_for_service(f"/gazebo/{service}")


class Environment:
    """The robot, as the tutorial's task environment sees it."""

    def __init__(self, seconds):
        self.seconds, self.gazebo = seconds, Gazebo()
        self.gazebo.unpause()
        self.wait_for_sensors()
        rospy.Subscriber("/odom", Odometry, self.hear_odometry)
        rospy.Subscriber("/kobuki/laser/scan", LaserScan, self.hear_scan)
        self.velocity = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
        while self.velocity.get_num_connections() == 0:
            time.sleep(0.1)
        self.filtered = rospy.Publisher("/turtlebot2/laser/scan_filtered", LaserScan, queue_size=1)
        self.reward = rospy.Publisher("/openai/reward", RLExperimentInfo, queue_size=1)
        self.gazebo.pause()

    def wait_for_sensors(self):
        self.odometry = rospy.wait_for_message("/odom", Odometry, timeout=30.0)
        self.scan = rospy.wait_for_message("/kobuki/laser/scan", LaserScan, timeout=30.0)

    def hear_odometry(self, message):
        self.odometry = message

    def hear_scan(self, message):
        self.scan = message

    def reset(self):
        self.gazebo.pause()
        self.gazebo.reset_world()
        self.gazebo.unpause()
        self.wait_for_sensors()
        self.move(0.0, 0.0)
        self.gazebo.pause()
        return self.observe()

    def step(self, action):
        self.gazebo.unpause()
        self.move(*ACTIONS[action])
        self.gazebo.pause()
        state = self.observe()
        collided = any(0.0 < robot_state < COLLISION for robot_state in self.kept())
        reward = -200 if collided else 5 if action == 0 else 1
        return state, reward, collided

    def move(self, linear, angular):
        command = Twist()
        command.linear.x, command.angular.z = linear, angular
        self.velocity.publish(command)
        time.sleep(self.seconds)

    def kept(self):
        return self.scan.ranges[::KEPT]

    def observe(self):
        self.filtered.publish(self.scan)
        return tuple(
            FARTHEST if robot_state == float("inf") else min(int(robot_state), FARTHEST) for robot_state in self.kept()
        )


def train(episodes, steps, seconds):
    """Learn, and print a line for each episode."""
    environment, values, epsilon = Environment(seconds), {}, EPSILON
    for episode in range(episodes):
        state, rewards = environment.reset(), []
        if epsilon > 0.05:
            epsilon *= 0.999
        for _ in range(steps):
            known = [values.get((state, action), 0.0) for action in range(len(ACTIONS))]
            action = random.randrange(3) if random.random() < epsilon else known.index(max(known))
            after, reward, done = environment.step(action)
            rewards.append(reward)
            future = max(values.get((after, each), 0.0) for each in range(len(ACTIONS)))
            old = values.get((state, action))
            values[state, action] = reward if old is None else old + ALPHA * (reward + GAMMA * future - old)
            state = after
            if done:
                break
        environment.reward.publish(RLExperimentInfo(episode_number=episode, episode_reward=sum(rewards)))
        x = environment.odometry.pose.pose.position.x
        print(
            json.dumps({"steps": len(rewards), "reward": sum(rewards), "done": done, "x": x, "state": state}),
            flush=True,
        )
    print(json.dumps({"values": len(values)}), flush=True)


if __name__ == "__main__":
    random.seed(0)
    rospy.init_node("tutorial_training", anonymous=True)
    train(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
