"""Which way is up: what the shape and the kind of file say, and the vote among them."""
