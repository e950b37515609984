"""Logs of a moving robot as laboratories have them, each read as one table with one clock."""
