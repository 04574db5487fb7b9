"""Drawing of a world and a robot from above, without a window, from numbers alone: `env.render()` and films use it."""
