"""Insides from pictures of one thing: layers that continue differently along the axis that a picture does not show."""
