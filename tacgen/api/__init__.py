"""The names of `import tacgen`: frames of a press computed and read in a few lines of Python.

They are names of the package `tacgen`; import them from there.
"""
