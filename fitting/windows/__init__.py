"""Which samples of the traces are fitted: spans at rest and in motion, windows, lost frames; and one fit of them."""
