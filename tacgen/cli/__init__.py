"""The command line: the app and its first commands in `main`, families of commands in files of their own."""
