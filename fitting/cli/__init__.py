"""Commands of `dropper` that work with traces and batches; heavy modules are imported only when a command runs."""
