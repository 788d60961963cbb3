"""What is wrong with a dataset: damage, doubtful rows, missing labels; and mending what can be mended."""

from rcs.lazy import load_on_use

load_on_use(__name__)
