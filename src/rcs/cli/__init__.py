"""The command `rcs`: one file per verb."""
