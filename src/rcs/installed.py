"""Importing this registers the Gymnasium ids of all installed packages; `import rcs` registers those of its own only.

Examples:
    >>> import gymnasium
    >>> env = gymnasium.make("rcs.installed:rcs/PickCuboid-FR3-v0")
"""

from rcs.setups.ids import ids, register

register(ids())
