"""ROS 1 and ROS 2: policies drive robots, and programs of ROS drive our simulated robot.

`messages` are plain values, and `node` is the interface to ROS that `ros1` (rospy) and `ros2` (rclpy) implement; only
the one that is asked for is imported. Everything else is independent of ROS: `simulation_server` publishes a
`simulated_robot`, `driver_node` connects a driver, and `robot` makes an environment of a robot, with `remote` as its
simulator. May import: drivers and the packages below them, and ROS.
"""
