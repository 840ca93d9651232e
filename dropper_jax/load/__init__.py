"""Where scenes come from: packaged names, TOML and MoorDyn files, plain values."""
