"""The honest test of the discovery: hidden effects, known to the scorer alone."""
