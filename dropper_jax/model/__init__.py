"""The model: a frozen pytree of arrays, and what effects see of one instant of it."""
