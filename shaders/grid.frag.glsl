// Weighted colour and weight of an interior atom at a grid point, added up.
flat in vec3 shape;
flat in vec4 colour;
flat in float limit;

layout(location = 0) out vec4 weighted;

void main() {
    vec2 u = gl_FragCoord.xy - shape.xy;
    float square = dot(u, u);
    if (square > limit) discard;
    weighted = colour * exp(-square * shape.z);
}
