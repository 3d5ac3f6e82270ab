"""Measurements of the program itself: how far it may be pushed, how right it is, what it costs."""
