"""Dynamic obstacles: people, posts and boxes that move beside the robots, the same in every simulator."""
