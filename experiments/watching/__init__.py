"""Watch a day of measurements while its rows arrive: check postures, notice changes, tell when to stop."""
