"""Numerics of the optics: arrays in, arrays or plain dictionaries out. No files, no renderer."""
