"""Model and initial state of a scene: growth, wakes and flow coefficients first, then what acts, then the start."""
