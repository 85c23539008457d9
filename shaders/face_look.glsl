// Coverage, colour and light of a cut face: the laws of engine/render/cpu/ray_entry.py.

// Fraction of a pixel that is solid. World units: footprint of the pixel, edge_sigma half the pitch.
float face_coverage(float density, float footprint, float edge_sigma) {
    float slope = max(1.0, edge_sigma / (EDGE_SLOPE * footprint)) / (2.0 * SOLID_DENSITY);
    return clamp(0.5 + (density - SOLID_DENSITY) * slope, 0.0, 1.0);
}

// Factor on the skin's weights in a face's colour, from the sum of the interior's.
float skin_part(float interior) {
    return max(1.0 - interior / FILLED_DENSITY, 0.0);
}

// Brightness under a lamp at the eye, from unit vectors: the face's normal and the way to the eye.
float face_light(vec3 normal, vec3 towards) {
    return FACE_AMBIENT + FACE_LAMP * max(dot(normal, towards), 0.0);
}
