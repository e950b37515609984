"""From an identification to a model file of the robot."""
