"""An ideal camera: no housing, no mass, any size."""
