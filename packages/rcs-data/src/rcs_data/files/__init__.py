"""Files of a dataset on disk, each written so that a kill leaves it whole or absent, and read back."""
