"""The app's data and the functions on it, without a window or processes.

The document (cuts, placements, families) with its history and files, the pieces derived from it, the camera, the knife,
films and settings.
"""
