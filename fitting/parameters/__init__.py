"""Which numbers of a scene are free, what they are called and where they live in the model."""
