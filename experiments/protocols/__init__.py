"""What a laboratory needs to carry a plan out: order, motions, drawings and the start of its measurements."""
