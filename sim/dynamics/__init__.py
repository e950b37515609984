"""The experiment in the full dynamics of MuJoCo."""
