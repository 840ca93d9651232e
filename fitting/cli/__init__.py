"""Commands of `dropper` that work with traces and batches; nothing heavy is imported before one runs."""
