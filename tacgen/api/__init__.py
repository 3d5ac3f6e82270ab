"""The names of `import tacgen`: frames of a press computed and read in a few lines of Python. Its names are those of the
package; import them from there."""
