"""The app's data and the functions on it, without a window or processes.

The document (cuts, placements, families) with its history and files, the pieces that follow from it, the camera, the
knife, exports and settings.
"""
