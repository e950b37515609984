"""From a laboratory's own table to a measurement folder."""
