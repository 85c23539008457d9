"""The window: draws a session and passes on what the user does. Nothing is kept here that undo or a file would miss."""
