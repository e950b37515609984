"""Families of ordinary imperfections, estimated together with the base parameters."""
