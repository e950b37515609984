"""The virtual laboratory: the only place where the truth lives."""
