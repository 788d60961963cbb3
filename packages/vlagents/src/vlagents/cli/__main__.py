"""`python -m vlagents.cli`."""

import sys

from vlagents.cli.main import main

sys.exit(main())
