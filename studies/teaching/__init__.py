"""Pictures that teach: what each shows is computed in a function of its own and drawn in one style."""
