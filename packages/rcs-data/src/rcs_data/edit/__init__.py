"""Edits of recorded datasets: each takes effect in one step, is listed in the history, and can be undone."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
