"""Virtual robots: simulated robots behind the interfaces of real ones, with delay and noise."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
