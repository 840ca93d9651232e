"""Studies of scenes: accuracy and cost of runs, errors of loads, offsets, tides, design values; `dropper doctor`."""
