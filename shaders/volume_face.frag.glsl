// A cut face read from a volume: colour and coverage where a pixel's ray meets the plane. Brightness is finer than hue.
#include "camera.glsl"
#include "cut.glsl"

uniform sampler3D body;       // distance under the skin, which is at a half
uniform sampler3D luma;
uniform sampler3D blue;       // differences from the brightness, half as fine
uniform sampler3D red;
uniform mat4 to_object;       // camera space to object space
uniform vec3 body_scale, body_shift;     // object space to texture coordinates
uniform vec3 colour_scale, colour_shift;
uniform float tolerance;      // world units
uniform int cut_index;
uniform int plane_count;
uniform vec4 planes[MAX_PLANES]; // camera space; the piece's planes, this one too

const float GREY = 0.50196; // byte 128: no difference

layout(location = 0) out vec4 face; // rgb, coverage
layout(location = 1) out float face_depth;

void main() {
    vec3 p = hit(gl_FragCoord.xy);
    vec3 at = (to_object * vec4(p, 1.0)).xyz;
    vec3 in_body = at * body_scale + body_shift;
    float depth = texture(body, in_body).r - 0.5;
    float coverage = clamp(0.5 + depth / max(fwidth(depth), 1e-5), 0.0, 1.0);
    bool outside = any(lessThan(in_body, vec3(0.0))) || any(greaterThan(in_body, vec3(1.0)));
    vec3 in_colour = at * colour_scale + colour_shift;
    float y = texture(luma, in_colour).r;
    float b = texture(blue, in_colour).r - GREY;
    float r = texture(red, in_colour).r - GREY;
    if (!(coverage > 0.0 && p.z > near) || outside) discard;
    for (int j = 0; j < plane_count; j++)
        if (j != cut_index && dot(planes[j].xyz, p) + planes[j].w > tolerance) discard;
    face = vec4(clamp(y + vec3(1.402 * r, -0.344136 * b - 0.714136 * r, 2.0 * (1.0 - 0.114) * b), 0.0, 1.0), coverage);
    face_depth = p.z;
    gl_FragDepth = coverage >= FACE_OPAQUE ? linear_depth(p.z) : 1.0;
}
