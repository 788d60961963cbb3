"""Recording: rows, images and episodes that survive a kill, and what completes them."""
