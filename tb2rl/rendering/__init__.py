"""A world and a robot drawn from above, without a window: what `env.render()` gives, and what films are made of.

Only numbers come in, so that environments can draw without knowing what shows them. Imported from here: worlds, robots.
"""
