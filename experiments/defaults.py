"""Defaults of public functions; this module loads nothing, so that the command line's help is quick."""

DEFAULT_SEED = 1
DEFAULT_ESTIMATOR = "self-calibrating"  # of everything that identifies
ORDINARY = 1.0  # scale of the imperfections of an ordinary laboratory
HOPS = 60  # of the search for a plan: exchanges of a placement's postures
REPEATS = 10  # of a protocol: postures that are measured twice
SPEED = 0.5  # rad/s, of any joint
MOTION_SPEED = 0.3  # rad/s, of any joint of a robot that is measured while it moves
