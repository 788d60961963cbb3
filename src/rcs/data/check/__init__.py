"""Finds damage, doubtful rows and missing labels in a dataset, and repairs what it can."""

from __future__ import annotations

from rcs.data.check.dataset import check
from rcs.data.check.report import CheckReport, Finding, Severity

__all__ = ["CheckReport", "Finding", "Severity", "check"]
