"""Pictures, films, PyBullet's window, teleoperation, charts, tables and the report.

No code in this package is specific to a robot, task or world.
"""
