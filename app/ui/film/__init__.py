"""The film in the window: its timeline below the object, and the window to save it."""
