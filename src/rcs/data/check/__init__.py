"""What is wrong with a dataset: damage, doubtful rows, missing labels; and mending what can be mended."""

from __future__ import annotations

from rcs.data.check.dataset import check
from rcs.data.check.report import CheckReport, Finding, Severity

__all__ = ["CheckReport", "Finding", "Severity", "check"]
