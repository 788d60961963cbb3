"""Datasets as other programs have them: export to their layouts, and import from them."""
