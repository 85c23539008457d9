// Coverage of the outside: the laws of engine/render/cpu/weights.py.

// Covered part of a pixel, from its sums of weights and of weights times sharpness.
float coverage(float weight, float edge) {
    return weight > MIN_WEIGHT ? clamp(0.5 + (weight - 0.5) * edge / weight, 0.0, 1.0) : 0.0;
}

// How much of the colour behind the layer is that of a fragment at depth z: a quarter for each layer's depth.
float depth_weight(float z, float front, float layer) {
    return exp2(-2.0 * min(floor(z / layer) - floor(front / layer), FADE_LAYERS));
}

// Shares of a pixel that show what is in the layer, before and behind it, from the weights there and the weights times
// sharpness. They add up to alpha; without a layer there is nothing.
vec3 outside_shares(vec3 weights, vec3 edges) {
    if (!(weights.x > MIN_WEIGHT)) return vec3(0.0);
    float before = coverage(weights.y, edges.y);
    float layer = (1.0 - before) * coverage(weights.x, edges.x);
    return vec3(layer, before, (1.0 - before - layer) * coverage(weights.z, edges.z));
}
