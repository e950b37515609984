"""The documents for carrying a plan out in a laboratory: order, motions, drawings and the start of its measurements."""
