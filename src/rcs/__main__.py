"""`python -m rcs`: the same as the command `rcs`."""

from rcs.cli.main import main

main()
