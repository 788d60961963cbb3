"""The index of a dataset: which episodes it has, and what edits have changed."""
