"""`tutorial.py EPISODES STEPS SECONDS`: the calls of the 2018 tutorial's training in their order, with random actions.

It is written from the list of calls of the tutorial's programs and `openai_ros`, and imports nothing of ours; SECONDS
is the wall-clock time of an action, 0.2 there.
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
from openai_ros.robot_gazebo_env import RobotGazeboEnv  # noqa: F401 (of the tutorial itself)
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Empty

ACTIONS = ((0.5, 0.0), (0.05, 0.3), (0.05, -0.3))  # forward, left, right: v [m/s], w [rad/s]
SERVICES = ("pause_physics", "unpause_physics", "reset_simulation", "reset_world")


class Environment:
    """The robot and the services of Gazebo, as the tutorial's task environment sees them."""

    def __init__(self, seconds):
        self.seconds = seconds
        proxies = [rospy.ServiceProxy(f"/gazebo/{service}", Empty) for service in SERVICES]
        self.pause, self.unpause, _, self.reset_world = proxies
        rospy.wait_for_service("/gazebo/set_physics_properties")
        rospy.ServiceProxy("/gazebo/set_physics_properties", SetPhysicsProperties)
        for service in SERVICES:
            rospy.wait_for_service(f"/gazebo/{service}")
        self.unpause()
        self.wait_for_sensors()
        rospy.Subscriber("/odom", Odometry, lambda message: setattr(self, "odometry", message))
        rospy.Subscriber("/kobuki/laser/scan", LaserScan, lambda message: setattr(self, "scan", message))
        self.velocity = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
        while self.velocity.get_num_connections() == 0:
            time.sleep(0.1)
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
        """Execute an action; return whether the robot has collided."""
        self.unpause()
        self.move(*ACTIONS[action])
        self.pause()
        return any(0.0 < each < 0.5 for each in self.scan.ranges[::144])

    def move(self, linear, angular):
        command = Twist()
        command.linear.x, command.angular.z = linear, angular
        self.velocity.publish(command)
        time.sleep(self.seconds)


random.seed(0)
rospy.init_node("tutorial_training", anonymous=True)
environment = Environment(float(sys.argv[3]))
for episode in range(int(sys.argv[1])):
    environment.reset()
    steps, collided = 0, False
    while steps < int(sys.argv[2]) and not collided:
        steps, collided = steps + 1, environment.step(random.choice([0, 0, 1, 2]))
    environment.reward.publish(RLExperimentInfo(episode_number=episode, episode_reward=steps))
    x, readings = environment.odometry.pose.pose.position.x, len(environment.scan.ranges)
    print(json.dumps({"steps": steps, "collided": collided, "x": x, "readings": readings}), flush=True)
print(SetPhysicsProperties._md5sum)
