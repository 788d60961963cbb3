"""`python -m rcs`: the same as the command `rcs`; `--cmake-dir` prints where CMake finds the package for devices in C++."""

import sys
from pathlib import Path

if sys.argv[1:] == ["--cmake-dir"]:
    from rcs import _core

    sys.stdout.write(f"{Path(_core.__file__).parent / 'cmake'}\n")
else:
    from rcs.cli.main import main

    main()
