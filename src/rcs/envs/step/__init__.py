"""One step of one environment or many copies: chains, stack, clock and engine."""
