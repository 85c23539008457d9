"""How the main job and a frame scale with threads: `python -m benchmarks.threads`."""
