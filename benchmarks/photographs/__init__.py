"""Benchmarks on real photographs."""
