"""Watch a day of measurements while its rows arrive: check every posture, notice changes, tell when to stop."""
