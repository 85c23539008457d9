// The kernel field at the point where the pixel's ray meets the plane: weighted colour and weight, added up.
#include "camera.glsl"

uniform sampler2D hull;
uniform float index;

flat in vec3 centre;
flat in vec4 colour;
#ifdef ELLIPSOID
flat in mat3 whiten;
#else
flat in float spread;
#endif

layout(location = 0) out vec4 weighted;

void main() {
    vec4 point = texelFetch(hull, ivec2(gl_FragCoord.xy), 0);
    if (point.w != index) discard;
    vec3 offset = point.xyz - centre;
    float weight = colour.w;
#ifdef ELLIPSOID
    offset = whiten * offset;
    float q = dot(offset, offset);
#else
    float used = spread;
#ifdef MINIFIED
    float z = view[0].z * point.x + view[1].z * point.y + view[2].z * point.z + view[3].z;
    used = max(spread, 0.5 * footprint_at(z));
    float ratio = spread / used;
    weight *= ratio * ratio * ratio;
#endif
    float q = dot(offset, offset) / (used * used);
#endif
    if (q > CUTOFF_Q) discard;
    weight *= exp(-0.5 * q);
    weighted = vec4(weight * colour.rgb, weight);
}
