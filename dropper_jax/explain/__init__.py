"""Questions that users ask most about a mooring, answered by numbers next to a closed form or a second equilibrium."""
