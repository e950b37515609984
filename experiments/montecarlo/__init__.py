"""Many repetitions of one experiment with known truth: is the estimator right about its own errors?"""
