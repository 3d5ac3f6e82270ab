"""Optics of a tactile sensor: numbers in, arrays or plain dictionaries out. Knows no stage and opens no file."""
