"""Pictures, films, the live viewer in the browser, charts, tables and the report.

No code in this package is specific to a robot, task or world.
"""
