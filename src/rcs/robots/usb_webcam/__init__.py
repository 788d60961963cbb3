"""A plain USB camera, a board with a small lens as sold by InnoMaker and others."""
