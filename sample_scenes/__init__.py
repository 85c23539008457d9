"""Scenes of this project's own making: solids whose inside is known everywhere, and the shells made from them."""
