"""A simulation that a person plays with: what they ask for, an episode that goes on, a page and a window to see it in."""
