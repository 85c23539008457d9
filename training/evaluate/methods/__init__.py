"""What is compared: the main job, parts of it left out, and other ways to colour an inside."""
