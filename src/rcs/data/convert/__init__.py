"""Exports datasets to the formats of other programs, and imports them."""
