"""The referee: what the contact forces of simulators of soft pads are worth, in one run that anyone can repeat."""
