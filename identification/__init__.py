"""What a real experiment could know: nominal kinematics and measurements only."""
