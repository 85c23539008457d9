"""The cut face in a photograph: which pixels belong to it, where its axis is, and what kind of cut it shows."""
