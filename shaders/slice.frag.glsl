// The kernel field at the point where the pixel's ray meets the plane: weighted colour and weight, summed by
// blending.
#include "camera.glsl"
#include "cut.glsl"

flat in vec3 centre;
flat in vec4 colour;
#ifdef ELLIPSOID
flat in mat3 whiten;
#else
flat in float spread;
#endif

uniform float tolerance;         // world units
uniform int other_count;
uniform vec4 others[MAX_PLANES]; // the piece's other planes, camera space

layout(location = 0) out vec4 weighted;

void main() {
    vec3 p = hit(gl_FragCoord.xy);
    for (int m = 0; m < other_count; m++)
        if (dot(others[m].xyz, p) + others[m].w > tolerance) discard;
    vec3 offset = p - centre;
    float weight = colour.w;
#ifdef ELLIPSOID
    offset = whiten * offset;
    float q = dot(offset, offset);
#else
    float used = max(spread, 0.5 * footprint_at(p.z));
    float ratio = spread / used;
    weight *= ratio * ratio * ratio;
    float q = dot(offset, offset) / (used * used);
#endif
    if (q > CUTOFF_Q || !(p.z > near)) discard;
    weight *= exp(-0.5 * q);
    weighted = vec4(weight * colour.rgb, weight);
}
