"""Predict the effects that a plan can detect, cannot distinguish or would hide."""
