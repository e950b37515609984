"""The parts of the study `improve`: one module for each of the paper's ways to improve."""
