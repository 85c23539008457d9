// Pass 1 (VISIBILITY): the depth of an atom's core. Pass 2: weight, weighted colour, weighted sharpness.
#include "camera.glsl"

flat in vec4 centre;
flat in vec4 conic;
flat in vec2 depth_slope;
flat in vec3 colour;

uniform float behind;
#ifdef CLIPPED
uniform int plane_count;
uniform vec4 planes[MAX_PLANES]; // camera space; distances are negative on the kept side
#endif

#ifndef VISIBILITY
layout(location = 0) out vec4 weighted;
layout(location = 1) out float sharpness;
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
#ifdef POINTS
    gl_FragDepth = linear_depth(z - behind);
#endif
#ifndef VISIBILITY
    float g = centre.w * exp(-0.5 * q);
    weighted = vec4(g * colour, g);
    sharpness = g * conic.w;
#endif
}
