// VISIBILITY: the depth of an atom's core. NEAR_PART: weight, weighted colour and weighted sharpness in the layer at the
// front and before it; FAR_PART: the same behind it.
#include "camera.glsl"
#include "outside_look.glsl"

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

layout(location = 0) out vec4 in_layer; // weighted rgb, weight
layout(location = 1) out vec4 before;
layout(location = 2) out vec4 behind;   // by depth_weight too
layout(location = 3) out vec4 edges;    // weighted sharpness in the layer, before and behind it; weight behind it
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
#ifndef VISIBILITY
    float g = centre.w * exp(-0.5 * q);
    float nearest = texelFetch(front, ivec2(gl_FragCoord.xy), 0).r;
    bool is_behind = linear_depth(z - layer) > nearest;
#ifdef NEAR_PART
    if (is_behind) discard;
#endif
#ifdef FAR_PART
    if (!is_behind) discard;
#endif
    bool is_before = nearest < 1.0 && linear_depth(z + layer) < nearest;
    float far = is_behind ? depth_weight(z, depth_at(nearest), layer) : 0.0;
    vec4 weighted = g * vec4(colour, 1.0);
    vec3 places = vec3(!is_behind && !is_before, is_before, is_behind);
    in_layer = places.x * weighted;
    before = places.y * weighted;
    behind = far * weighted;
    edges = vec4(g * conic.w * places, g * places.z);
#endif
}
