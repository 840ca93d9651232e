"""Runs that another program drives: a step at a time, as lines on its body, or as an FMU."""
