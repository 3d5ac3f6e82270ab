"""A sensor file: its model, its checks, and YAML with the position of every value for messages that point there."""
