"""The labs of the paper, one per file. Camera poses are ours: the paper does not print them."""
