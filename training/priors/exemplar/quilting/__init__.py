"""Insides from photographs of different individuals: chunks of pictures, joined where they agree."""
