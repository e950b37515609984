"""Experiment after experiment in the virtual laboratory, until one explanation is left."""
