"""Print a board of AprilTags, find how a camera sees and where it is, and check that it still is there.

This is the table of its verbs.
"""

from __future__ import annotations

from rcs_data.cli.program import Table

VERBS: Table = {
    "board": "rcs.cli.calibrate.board:BoardCommand",
    "intrinsics": "rcs.cli.calibrate.camera:IntrinsicsCommand",
    "hand-eye": "rcs.cli.calibrate.camera:HandEyeCommand",
    "check": "rcs.cli.calibrate.camera:CheckCommand",
    "leader": "rcs.cli.calibrate.leader:LeaderCommand",
}
