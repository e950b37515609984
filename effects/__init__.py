"""Physical effects: what they are, and how they enter and leave an experiment."""
