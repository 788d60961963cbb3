"""The Intel RealSense D405, a stereo camera for short range."""
