// Weighted colour and weight of an interior atom at a grid point, summed by blending.
flat in vec3 shape;
flat in vec4 colour;
flat in float limit;

layout(location = 0) out vec4 weighted;

void main() {
    vec2 u = gl_FragCoord.xy - shape.xy;
    float square = dot(u, u);
    float rim = clamp(sqrt(limit) - sqrt(square) + 0.5, 0.0, 1.0);
    if (rim <= 0.0) discard;
    weighted = rim * colour * exp(-square * shape.z);
}
