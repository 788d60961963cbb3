"""MCAP files, for Foxglove and Rerun."""
