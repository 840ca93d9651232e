"""What a run is worth and what it costs: accuracy against time, hard cases, price of each effect. Built on the core."""
