"""The methods that are compared: the main job, the same without some of its parts, and other ways to colour insides."""
