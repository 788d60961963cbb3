"""Reading: datasets, episodes, single images, and windows for training."""
