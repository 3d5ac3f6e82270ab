"""What the solved gel is asked for beyond its shape: maps, stress, markers' motion."""
