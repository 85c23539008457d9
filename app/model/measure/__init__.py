"""Three perpendicular cut faces, and measurements of the object."""
