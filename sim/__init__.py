"""The virtual laboratory, the only room that knows the true parameters of a simulation."""
