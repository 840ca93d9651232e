"""`dropper frequency`: motions and tensions in irregular waves in the frequency domain, with linearised drag."""
