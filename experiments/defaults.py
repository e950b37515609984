"""Defaults of public functions; this module loads nothing, so that the command line's help is quick."""

DEFAULT_SEED = 1
SAMPLES = 200  # random robots beside an exported model
