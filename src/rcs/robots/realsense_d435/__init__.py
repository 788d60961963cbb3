"""The Intel RealSense D435, a stereo camera with a separate colour sensor."""
