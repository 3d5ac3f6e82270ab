"""Modules that all folders use: errors, files, the terminal, tables, caches, compiled code, clock, version."""
