"""Errors, files, tables, numbers in words, threads and workers, for any program; knows no robot."""
