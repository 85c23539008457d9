"""Motion: films with keyframes of the camera, the planes and the explosion, and an object that is thrown."""
