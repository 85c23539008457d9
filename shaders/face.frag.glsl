// A cut face: the field divided, its coverage, its light; an opaque pixel of it hides the splats behind.
#include "camera.glsl"
#include "cut.glsl"

#ifdef GRID
uniform sampler2D grid;   // the field of the interior atoms on this plane
uniform mat4 to_grid;     // camera space to texture coordinates
#endif
uniform sampler2D field;  // what was added up pixel by pixel
uniform float edge_sigma; // half the pitch, world units
uniform float light;      // 0 or 1

layout(location = 0) out vec4 face; // rgb, coverage
layout(location = 1) out float face_depth;

void main() {
    vec3 p = hit(gl_FragCoord.xy);
    vec4 sum = texelFetch(field, ivec2(gl_FragCoord.xy), 0);
#ifdef GRID
    sum += texture(grid, (to_grid * vec4(p, 1.0)).xy);
#endif
    float slope = max(1.0, edge_sigma / (EDGE_SLOPE * footprint_at(p.z))) / (2.0 * SOLID_DENSITY);
    float coverage = clamp(0.5 + (sum.a - SOLID_DENSITY) * slope, 0.0, 1.0);
    if (!(coverage > 0.0 && sum.a > 0.0 && p.z > near)) discard;
#ifdef ORTHOGRAPHIC
    vec3 towards = vec3(0.0, 0.0, -1.0);
#else
    vec3 towards = -normalize(p);
#endif
    float shade = mix(1.0, FACE_AMBIENT + FACE_LAMP * max(dot(cut_in_camera.xyz, towards), 0.0), light);
    face = vec4(shade * sum.rgb / sum.a, coverage);
    face_depth = p.z;
    gl_FragDepth = coverage >= FACE_OPAQUE ? linear_depth(p.z) : 1.0;
}
