"""What a plan would detect, confuse or hide, before any data."""
