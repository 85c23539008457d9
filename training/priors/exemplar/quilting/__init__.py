"""Insides from photographs of different individuals: chunks of pictures, joined where they agree (DESIGN 5.1)."""
