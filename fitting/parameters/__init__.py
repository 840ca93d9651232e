"""Free parameters of a scene: their names and their positions in the model."""
