"""Bundles on disk: layout, reading and writing, checks, resuming, packing."""
