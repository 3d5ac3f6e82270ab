"""Bundles on disk and what surrounds them: layout, sources, caches, resuming, packing."""
