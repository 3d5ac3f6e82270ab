"""The modes of a contact as a whole, by their numbers in bundles; contact_events says when each is true."""

CONTACT_MODES = ("apart", "touching", "sticking", "partly slipping", "sliding", "turning", "releasing")
