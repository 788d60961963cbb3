"""LeRobotDatasets, v3.0 and v2.1, for LeRobot, openpi and GR00T."""
