"""Measures the insides on scenes whose inside is known, beside simpler methods and without each part in turn."""
