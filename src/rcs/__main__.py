"""`python -m rcs`: the command `rcs`; with `--cmake-dir`, print where CMake finds the package for devices in C++."""

import sys
from importlib.util import find_spec
from pathlib import Path

if sys.argv[1:] == ["--cmake-dir"]:
    core = find_spec("rcs._core")  # what CMake installed lies beside the extension, also where `rcs` is editable
    assert core is not None
    assert core.origin is not None
    sys.stdout.write(f"{Path(core.origin).with_name('cmake')}\n")
else:
    from rcs.cli.main import main

    main()
