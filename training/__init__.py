"""Interior textures: cut families, priors, training and the commands."""
