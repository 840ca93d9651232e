"""Many members of one function side by side in the registers of a processor."""
