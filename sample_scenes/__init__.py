"""Synthetic scenes: solids whose inside is known everywhere, and the shells made from them."""
