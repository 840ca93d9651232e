"""What everything stands on: errors, declared fields, checked reading, numerics, files."""
