"""A driver of one's own with a virtual device to test it, to copy and change."""
