"""The face in a picture while the user corrects it: edits of its outline, and texts about it."""
