"""A training as the 2018 tutorial's: its calls in its order, against a robot in Gazebo or a simulation in its place.

    tutorial.py EPISODES STEPS SECONDS    # wall-clock time of an action: 0.2 there

It is written from the list of calls of the tutorial's programs and `openai_ros`, and imports nothing of ours. Its
actions are random, because the learner makes no calls.
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


class Environment:
    """The robot and the services of Gazebo, as the tutorial's task environment sees them."""

    def __init__(self, seconds):
        self.seconds = seconds
        services = ("pause_physics", "unpause_physics", "reset_simulation", "reset_world")
        proxies = [rospy.ServiceProxy(f"/gazebo/{service}", Empty) for service in services]
        self.pause, self.unpause, self.reset_simulation, self.reset_world = proxies
        rospy.wait_for_service("/gazebo/set_physics_properties")
        self.set_physics = rospy.ServiceProxy("/gazebo/set_physics_properties", SetPhysicsProperties)
        for service in services:
            rospy.wait_for_service(f"/gazebo/{service}")
        self.unpause()
        self.wait_for_sensors()
        rospy.Subscriber("/odom", Odometry, lambda message: setattr(self, "odometry", message))
        rospy.Subscriber("/kobuki/laser/scan", LaserScan, lambda message: setattr(self, "scan", message))
        self.velocity = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
        while self.velocity.get_num_connections() == 0:
            time.sleep(0.1)
        self.filtered = rospy.Publisher("/turtlebot2/laser/scan_filtered", LaserScan, queue_size=1)
        self.reward = rospy.Publisher("/openai/reward", RLExperimentInfo, queue_size=1)
        self.pause()

    def wait_for_sensors(self):
        self.odometry = rospy.wait_for_message("/odom", Odometry, timeout=30.0)
        self.scan = rospy.wait_for_message("/kobuki/laser/scan", LaserScan, timeout=30.0)

    def reset(self):
        self.pause()
        self.reset_world()
        self.unpause()
        self.wait_for_sensors()
        self.move(0.0, 0.0)
        self.pause()

    def step(self, action):
        self.unpause()
        self.move(*ACTIONS[action])
        self.pause()
        self.filtered.publish(self.scan)
        ranges = self.scan.ranges[::KEPT]
        state = [FARTHEST if each == float("inf") else min(int(each), FARTHEST) for each in ranges]
        collided = any(0.0 < each < COLLISION for each in ranges)
        return state, -200 if collided else 5 if action == 0 else 1, collided

    def move(self, linear, angular):
        command = Twist()
        command.linear.x, command.angular.z = linear, angular
        self.velocity.publish(command)
        time.sleep(self.seconds)


def train(episodes, steps, seconds):
    """Drive at random, and print a line for each episode."""
    environment = Environment(seconds)
    for episode in range(episodes):
        environment.reset()
        rewards, done = [], False
        while len(rewards) < steps and not done:
            state, reward, done = environment.step(random.choice([0, 0, 1, 2]))
            rewards.append(reward)
        environment.reward.publish(RLExperimentInfo(episode_number=episode, episode_reward=sum(rewards)))
        x = environment.odometry.pose.pose.position.x
        line = {"steps": len(rewards), "reward": sum(rewards), "done": done, "x": x, "state": state}
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    random.seed(0)
    rospy.init_node("tutorial_training", anonymous=True)
    train(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
