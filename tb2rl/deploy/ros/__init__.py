"""Where ROS is: our robot as one of ROS 1 or ROS 2, and what carries a policy to a robot of either.

`messages` says what travels on topics, as plain values, and `graph` what a program asks of ROS. `ros1` and `ros2` are
that in rospy and in rclpy: neither is imported where the other is asked for. The programs are commands of
`python -m tb2rl.ros`, and know no ROS: `simulate` puts `simulator` on a graph, `drive` a driver by `pilot`. `robot` is
any robot of a graph as an environment, with `remote` in the place of a simulation. Imported from here: drivers and what
lies below them, and ROS.
"""
