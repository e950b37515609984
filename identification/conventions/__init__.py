"""The conventions of a log of wrenches and joint angles, audited by the wrench that the robot needs."""
