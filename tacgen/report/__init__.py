"""Finished things for people's eyes: pictures, summaries, cards, reports, tables."""
