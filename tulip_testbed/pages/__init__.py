"""A run as one HTML page that needs nothing else."""

ENDING = ".html"
# A sentence of pages that views show too.
NO_TRUE_COM = "The true centre of mass of each posture is not shown: the statics engine does not record it."
