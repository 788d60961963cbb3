"""Episodes and datasets on disk: write, read, check, recover, train on."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
