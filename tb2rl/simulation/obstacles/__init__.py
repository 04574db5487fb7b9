"""Dynamic obstacles: people, posts and boxes that move in the robots' worlds, the same in every simulator."""
