"""The Intel RealSense D435i, a D435 with an inertial measurement unit."""
