// A cut face: colour from the field's sums, coverage, light; an opaque pixel hides the splats behind it.
#include "camera.glsl"
#include "cut.glsl"
#include "face_look.glsl"

#ifdef GRID
uniform sampler2D grid;   // the field of the interior atoms on this plane
uniform mat4 to_grid;     // camera space to texture coordinates
#endif
uniform sampler2D field;  // the interior's sums, made pixel by pixel
uniform sampler2D skin_field;
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
    vec4 skin = texelFetch(skin_field, ivec2(gl_FragCoord.xy), 0);
    float coverage = face_coverage(sum.a + skin.a, footprint_at(p.z), edge_sigma);
    sum += skin_part(sum.a) * skin;
    if (!(coverage > 0.0 && sum.a > 0.0 && p.z > near)) discard;
#ifdef ORTHOGRAPHIC
    vec3 towards = vec3(0.0, 0.0, -1.0);
#else
    vec3 towards = -normalize(p);
#endif
    float shade = mix(1.0, face_light(cut_in_camera.xyz, towards), light);
    face = vec4(shade * sum.rgb / sum.a, coverage);
    face_depth = p.z;
    gl_FragDepth = coverage >= FACE_OPAQUE ? linear_depth(p.z) : 1.0;
}
