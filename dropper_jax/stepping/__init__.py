"""One step: choosing how, solving it, its derivatives, parting links, and many of them."""
