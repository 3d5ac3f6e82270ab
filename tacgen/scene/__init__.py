"""A scene as numbers: its path, its gel's mesh."""
