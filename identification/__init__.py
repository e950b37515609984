"""Identification from nominal kinematics and measurements, which is all that a real experiment provides."""
