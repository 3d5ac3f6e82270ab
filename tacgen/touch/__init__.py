"""Touch for recorded episodes of robots: read them, find the contacts, solve them, and add what both fingers felt.

read an episode -> find the intervals in contact -> write recipes -> run them -> label every row -> a copy with touch
"""
