"""Foundations used by the whole package: errors, declared fields, checked reading, numerics, files."""
