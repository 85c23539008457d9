"""Films: keyframes of the camera, of planes and of the explosion, and the motion between them."""
