"""What lies on disk: files of a dataset, each written so that a kill leaves it whole or absent, and read back."""
