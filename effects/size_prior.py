"""The prior of an effect's size: a Cauchy distribution with the plausible size as its scale (Gelman 2006).

A normal one would draw an effect of several plausible sizes far towards zero, and count its size against it.
Estimates use the normal distribution that has the same slope at the present size (majorise and minimise;
Hunter and Lange 2004); ln of the ratio of both densities there corrects the evidence.
"""

import numpy as np


def prior_sd(plausible: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the s.d. of the normal distribution in place of the prior, (...) [SI]."""
    return np.sqrt((plausible**2 + size**2) / 2)


def log_tail(plausible: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return ln of the prior's density over that of the normal distribution in its place, (...)."""
    sd = prior_sd(plausible, size)
    normal = -0.5 * (size / sd) ** 2 - np.log(sd * np.sqrt(2 * np.pi))
    return -np.log(np.pi * plausible * (1 + (size / plausible) ** 2)) - normal
