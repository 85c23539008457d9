// Pass 1 (VISIBILITY): the depth of an atom's core. Pass 2: weight, weighted colour and weighted sharpness in the layer
// behind the front; weight and weighted sharpness behind the layer.
#include "camera.glsl"

flat in vec4 centre;
flat in vec4 conic;
flat in vec2 depth_slope;
flat in vec3 colour;

#ifdef CLIPPED
uniform int plane_count;
uniform vec4 planes[MAX_PLANES]; // camera space; distances are negative on the kept side
#endif

#ifndef VISIBILITY
uniform sampler2D front; // linear depth
uniform float layer;     // its depth, world units

layout(location = 0) out vec4 weighted; // layer: weighted rgb, weight
layout(location = 1) out vec4 edges;    // layer: weighted sharpness; behind it: weight, weighted sharpness
#endif

void main() {
    vec2 u = gl_FragCoord.xy - centre.xy;
    float q = conic.x * u.x * u.x + 2.0 * conic.y * u.x * u.y + conic.z * u.y * u.y;
#ifdef VISIBILITY
    if (q > CORE_Q) discard;
#else
    if (q > CUTOFF_Q) discard;
#endif
    float z = centre.z + dot(depth_slope, u);
#ifndef ORTHOGRAPHIC
    if (z <= near) discard;
#endif
#ifdef CLIPPED
    vec3 p = point_at(gl_FragCoord.xy, z);
    for (int j = 0; j < plane_count; j++)
        if (dot(planes[j].xyz, p) + planes[j].w > 0.0) discard;
#endif
#ifdef VISIBILITY
#ifdef POINTS
    gl_FragDepth = linear_depth(z);
#endif
#else
    float g = centre.w * exp(-0.5 * q);
    bool in_layer = linear_depth(z - layer) <= texelFetch(front, ivec2(gl_FragCoord.xy), 0).r;
    weighted = in_layer ? vec4(g * colour, g) : vec4(0.0);
    edges = in_layer ? vec4(g * conic.w, 0.0, 0.0, 0.0) : vec4(0.0, g, g * conic.w, 0.0);
#endif
}
