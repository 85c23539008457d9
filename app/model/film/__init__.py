"""What moves: films, with keyframes of the camera, of planes and of the explosion, and an object that is thrown."""
