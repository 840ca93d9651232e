"""Sources of scenes: packaged names, TOML and MoorDyn files, plain values."""
