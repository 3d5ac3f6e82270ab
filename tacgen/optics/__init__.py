"""Optics as numbers in, arrays or plain dictionaries out; knows no stage, opens no file, imports no renderer."""
