// Coverage of the outside: the laws of engine/render/cpu/weights.py.

// Covered part of a pixel, from its sums of weights and of weights times sharpness.
float coverage(float weight, float edge) {
    return weight > MIN_WEIGHT ? clamp(0.5 + (weight - 0.5) * edge / weight, 0.0, 1.0) : 0.0;
}

// Alpha of a pixel, from the layer's weight and edges: the layer's, then weight and edge behind it. Without a layer there
// is no colour, whatever lies behind.
float outside_alpha(float weight, vec3 edges) {
    float layer = coverage(weight, edges.x);
    return weight > MIN_WEIGHT ? layer + (1.0 - layer) * coverage(edges.y, edges.z) : 0.0;
}
