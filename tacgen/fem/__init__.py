"""Finite elements and contact: arrays in, arrays out. Knows no stage and opens no file."""
