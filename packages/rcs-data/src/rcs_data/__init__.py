"""Episodes and datasets on disk: write, read, check, recover, train on."""

from rcs_data.lazy import load_on_use

load_on_use(
    __name__,
    open="Dataset(path)",
    load="Dataset(path)",
    export="rcs_data.convert, such as rcs_data.convert.export_lerobot",
)
