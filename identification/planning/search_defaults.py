"""The default of a search for postures; this module loads nothing, so that help is quick."""

HOPS = 60  # rounds that exchange postures of one placement
