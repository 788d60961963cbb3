"""Episodes and datasets on disk: write, read, check, recover, train on."""

from __future__ import annotations

from rcs.data.check import CheckReport, Finding, check
from rcs.data.content import compare_steps, steps_equal
from rcs.data.episode_writer import EpisodeWriter
from rcs.data.feature import Encoding, Feature
from rcs.data.frame_access import FrameAccess
from rcs.data.info import SCHEMA_VERSION, DatasetInfo
from rcs.data.reader import Dataset, EpisodeRecord
from rcs.data.recover import RecoverReport, recover
from rcs.data.statistics import Statistics
from rcs.data.windows import Window, WindowBatch, Windows
from rcs.data.writer import DatasetWriter

__all__ = [
    "SCHEMA_VERSION",
    "CheckReport",
    "Dataset",
    "DatasetInfo",
    "DatasetWriter",
    "Encoding",
    "EpisodeRecord",
    "EpisodeWriter",
    "Feature",
    "Finding",
    "FrameAccess",
    "RecoverReport",
    "Statistics",
    "Window",
    "WindowBatch",
    "Windows",
    "check",
    "compare_steps",
    "recover",
    "steps_equal",
]
