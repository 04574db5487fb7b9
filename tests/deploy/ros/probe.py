"""`probe.py 1|2`: a node of ROS that a test controls by lines of JSON; it imports nothing of ours."""

import base64
import json
import queue
import sys
import threading
import time
from importlib import import_module

VERSION = int(sys.argv[1])
RENAMED = {"secs": "sec", "nsecs": "nanosec"}  # fields of ROS 1 that have another name in ROS 2
PATIENCE = 60.0  # [s] the machine may be busy


def find(kind, part="msg"):
    package, name = kind.split("/")
    return getattr(import_module(f"{package}.{part}"), name)


def plain(value):
    """Convert a message to dicts, lists and numbers; uint8[] to base64."""
    if isinstance(value, bytes) or getattr(value, "typecode", "") == "B":
        return base64.b64encode(bytes(value)).decode()
    if hasattr(value, "__slots__"):
        slots = [name for name in value.__slots__ if name != "_check_fields"]
        return {RENAMED.get(name.lstrip("_"), name.lstrip("_")): plain(getattr(value, name)) for name in slots}
    if isinstance(value, str | int | float):
        return value
    return [plain(each) for each in value]


def to_seconds(stamp):
    return stamp["sec"] + 1e-9 * stamp["nanosec"]


def wait_until(condition, message):
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until, message
        time.sleep(0.02)


class Node1:
    def __init__(self):
        import rospy

        self.rospy = rospy
        rospy.init_node("probe", anonymous=True, disable_signals=True)

    def subscribe(self, topic, kind, callback):
        self.rospy.Subscriber(topic, find(kind), callback, tcp_nodelay=True)

    def publisher(self, topic, kind):
        publisher = self.rospy.Publisher(topic, find(kind), queue_size=10)
        return publisher.publish, publisher.get_num_connections

    def call(self, service, kind):
        self.rospy.wait_for_service(service, PATIENCE)
        answer = self.rospy.ServiceProxy(service, find(kind, "srv"))()
        return [getattr(answer, "success", True), getattr(answer, "message", "")]


class Node2:
    def __init__(self):
        import rclpy

        self.rclpy = rclpy
        rclpy.init()
        self.node = rclpy.create_node("probe")
        executor = rclpy.executors.SingleThreadedExecutor()
        executor.add_node(self.node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def subscribe(self, topic, kind, callback):
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        sensor = kind in ("sensor_msgs/LaserScan", "sensor_msgs/Image")
        reliability = ReliabilityPolicy.BEST_EFFORT if sensor else ReliabilityPolicy.RELIABLE
        self.node.create_subscription(find(kind), topic, callback, QoSProfile(depth=1000, reliability=reliability))

    def publisher(self, topic, kind):
        publisher = self.node.create_publisher(find(kind), topic, 10)
        return publisher.publish, publisher.get_subscription_count

    def call(self, service, kind):
        kind = find(kind, "srv")
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(PATIENCE), service
        answered, future = threading.Event(), client.call_async(kind.Request())
        future.add_done_callback(lambda _: answered.set())
        assert answered.wait(PATIENCE), service
        return [getattr(future.result(), "success", True), getattr(future.result(), "message", "")]


class Probe:
    def __init__(self):
        self.node = Node1() if VERSION == 1 else Node2()
        self.received, self.publishers = {}, {}

    def subscribe(self, topic, kind):
        """Keep the messages of a topic from now on."""
        self.received[topic] = queue.Queue()
        self.node.subscribe(topic, kind, self.received[topic].put)

    def take(self, topic, count=1, fresh=True):
        """The next messages; fresh: leaving out those that have come before."""
        while fresh and not self.received[topic].empty():
            self.received[topic].get_nowait()
        return [plain(self.received[topic].get(timeout=PATIENCE)) for _ in range(count)]

    def count(self, topic, seconds):
        """How many messages come within some seconds of wall-clock time."""
        self.received[topic].queue.clear()
        time.sleep(seconds)
        return self.received[topic].qsize()

    def pass_time(self, seconds):
        """Wait until so many simulated seconds have passed: how many wall-clock seconds that took."""
        began, (first,) = time.monotonic(), self.take("/clock")
        now = first
        while to_seconds(now["clock"]) < to_seconds(first["clock"]) + seconds:
            (now,) = self.take("/clock", fresh=False)
        return time.monotonic() - began

    def watch(self, velocity, odometry):
        """Record the times of the last commands to move and to stop, and when the robot last moved.

        `went on` is for how many simulated seconds it moved after a command.
        """
        self.last = last = {"move command": 0.0, "stop command": 0.0, "moved": 0.0, "went on": 0.0}
        stamps = {"command": 0.0, "now": 0.0}

        def on_command(message):
            if message.linear.x or message.angular.z:
                last["move command"], stamps["command"] = time.monotonic(), stamps["now"]
            elif last["stop command"] <= last["move command"]:
                last["stop command"] = time.monotonic()

        def on_odometry(message):
            twist = message.twist.twist
            stamps["now"] = to_seconds(plain(message.header.stamp))
            if abs(twist.linear.x) > 0.02 or abs(twist.angular.z) > 0.05:
                last["moved"], last["went on"] = time.monotonic(), stamps["now"] - stamps["command"]

        self.node.subscribe(velocity, "geometry_msgs/Twist", on_command)
        self.node.subscribe(odometry, "nav_msgs/Odometry", on_odometry)

    def watched(self, until=None, seconds=0.0):
        """Return the record of `watch`, some seconds after a new event of a kind, or after now."""
        began = time.monotonic()
        wait_until(lambda: until is None or self.last[until] >= began, self.last)
        time.sleep(seconds)
        return self.last

    def call(self, service, kind="std_srvs/Empty"):
        """Call a service; return whether it succeeded, and its message."""
        return self.node.call(service, kind)

    def relay(self, source, target, kind):
        """Publish the messages of a topic on another one, unless `mute` says otherwise."""
        self.muted, publish = False, self.node.publisher(target, kind)[0]
        self.node.subscribe(source, kind, lambda message: None if self.muted else publish(message))

    def mute(self, muted):
        self.muted = muted

    def send_goal(self, topic, x, y):
        """Publish a goal in the frame `odom`, as RViz does."""
        publish, listeners = self.node.publisher(topic, "geometry_msgs/PoseStamped")
        wait_until(listeners, f"no node subscribes to {topic}")
        message = find("geometry_msgs/PoseStamped")()
        message.header.frame_id, message.pose.orientation.w = "odom", 1.0
        message.pose.position.x, message.pose.position.y = float(x), float(y)
        publish(message)

    def parameter(self, name):
        return self.node.rospy.get_param(name, None)

    def drive(self, linear, angular, topic="/cmd_vel", until=None):
        """Publish a command as soon as a node subscribes, and again until there is a message on another topic: that."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.publisher(topic, "geometry_msgs/Twist")
        publish, listeners = self.publishers[topic]
        wait_until(listeners, f"no node subscribes to {topic}")
        message = find("geometry_msgs/Twist")()
        message.linear.x, message.angular.z = float(linear), float(angular)
        wait_until(lambda: publish(message) or until is None or not self.received[until].empty(), f"nothing on {until}")
        return plain(self.received[until].get()) if until else None


probe = Probe()
print(json.dumps("ready"), flush=True)
for line in sys.stdin:
    method, arguments, named = json.loads(line)
    print(json.dumps(getattr(probe, method)(*arguments, **named)), flush=True)
