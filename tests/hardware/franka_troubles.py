"""What goes wrong with a virtual FR3, and what its drivers say of it."""

from __future__ import annotations

TROUBLES = [
    (("reflex",), r"Reflex.*joint_reflex.*joint4.*something pushed"),
    (("user_stop",), r"user stop.*release"),
    (("brakes",), r"locked.*Desk"),
    (("code", 26), r"power_limit_violation.*too much power"),
    (("lose", 40), r"communication_constraints_violation.*were late"),
    (("freeze", 1.5), r"not answered|no state"),
    (("cut",), r"not answered|no state|link"),
]
