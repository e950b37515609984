"""Mutated inputs for the command line; importing this registers all mutations of folders."""

from tools.fuzz import columns, contents, documents, places, values

__all__ = ["columns", "contents", "documents", "places", "values"]
