"""Defaults of a search for postures; this module loads nothing, so that the command line's help is quick."""

HOPS = 60  # rounds that exchange postures of one placement
SOLVERS = ("slsqp", "ipopt")  # of the last round
