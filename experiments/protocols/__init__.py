"""Documents for carrying a plan out: order, motions, drawings and the start of its measurements."""
