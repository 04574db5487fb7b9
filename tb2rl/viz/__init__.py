"""Pictures, films, PyBullet's window, keyboard driving, charts, tables and the report's page. No code here is specific
to a robot, task or world.
"""
