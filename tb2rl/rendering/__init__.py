"""Pictures of a world and a robot from above, for `env.render()` and films; no display is needed."""
