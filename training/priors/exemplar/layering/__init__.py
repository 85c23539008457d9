"""Insides from pictures of one thing: layers that go on differently along the axis that a picture does not show."""
