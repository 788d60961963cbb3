"""Print a board of AprilTags, find how a camera sees and where it is, and check that it still is there.

Each verb has a file; this is their table.
"""

from __future__ import annotations

from rcs_data.cli.program import Table

VERBS: Table = {
    "board": "rcs.cli.calibrate.board:BoardCommand",
    "intrinsics": "rcs.cli.calibrate.intrinsics:IntrinsicsCommand",
    "hand-eye": "rcs.cli.calibrate.hand_eye:HandEyeCommand",
    "check": "rcs.cli.calibrate.check:CheckCommand",
    "leader": "rcs.cli.calibrate.leader:LeaderCommand",
}
