"""HDF5 files of robomimic and of ALOHA."""
