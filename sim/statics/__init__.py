"""Static equilibrium of robot, servos, feet and plates, solved directly and in batches."""
