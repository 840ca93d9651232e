"""Questions that users ask most about a mooring, answered by numbers beside a closed form or a second equilibrium."""
