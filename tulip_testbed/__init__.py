"""Study the static identification of humanoid robots in a virtual laboratory."""
