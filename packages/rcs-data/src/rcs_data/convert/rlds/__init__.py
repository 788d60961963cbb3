"""RLDS in folders of TensorFlow Datasets, for Octo and OpenVLA."""
