"""GLSL 3.30 core sources, loaded by the GL engine as package data."""
