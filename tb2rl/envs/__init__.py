"""What learners see: scenes, observations, and the environments in which one robot or thousands learn.

`scene.py` turns the names in a task's settings into objects, and is the only module that does; everything here and
above is handed the objects. Imported from here: tasks and what lies below them.
"""
