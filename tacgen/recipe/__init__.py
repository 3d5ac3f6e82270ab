"""Recipes as a person writes them, read, checked and resolved to scenes: movements, pose tables, plans."""
