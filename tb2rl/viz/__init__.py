"""What people look at: pictures from above, films, the window, keyboard driving, charts, tables and the report's page.

Nothing here knows a particular robot, task or world: who draws asks the scene. Imported from here: judging and below.
"""
