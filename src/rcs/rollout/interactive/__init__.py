"""A simulation that a person plays with: what they ask for, an episode that goes on, and a page or window of it."""
