"""The command `rcs`: a file per verb, or for those about one thing."""
