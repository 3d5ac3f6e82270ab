"""Labels from the solved gel: maps, stress, events, marker motion."""
