"""Saves films to a file or a folder of pictures, in a process beside the window."""
