"""From a published MJCF or URDF to a robot that stands in the laboratory."""
