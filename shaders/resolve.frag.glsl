// Normalises the sums of pieces that lie together and composites them into the frame by depth.
#include "camera.glsl"

#include "outside_look.glsl"

uniform sampler2D in_layer;  // weighted rgb, weight
uniform sampler2D rims;      // the same before the layer
uniform sampler2D behind;    // the same behind it, weighted by depth
uniform sampler2D edges;     // weighted sharpness in the layer, before and behind it; weight behind it
uniform sampler2D front;     // linear depth
#ifdef FACES
uniform sampler2D faces;     // rgb, coverage
uniform sampler2D face_depths;
uniform float tolerance;     // world units: a splat that the plane cuts is not in front of the face
#endif
#ifdef BELOW
uniform sampler2D below;     // the frame so far
uniform sampler2D below_info;
#endif
uniform vec3 background;
uniform float group;

layout(location = 0) out vec4 frame;
layout(location = 1) out vec2 info; // depth; 2 * group + coverage, group -1 if there is none

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 here = texelFetch(in_layer, at, 0), rim = texelFetch(rims, at, 0), far = texelFetch(behind, at, 0);
    vec4 edge = texelFetch(edges, at, 0);
    float stored = texelFetch(front, at, 0).r;
    float z = stored < 1.0 ? depth_at(stored) : NOTHING;
    vec3 shares = outside_shares(vec3(here.a, rim.a, edge.w), edge.xyz);
    float alpha = shares.x + shares.y + shares.z;
    vec3 over = shares.x / max(here.a, MIN_WEIGHT) * here.rgb + shares.y / max(rim.a, MIN_WEIGHT) * rim.rgb; // premultiplied
    if (shares.z > 0.0) over += shares.z / max(far.a, 1e-30) * far.rgb; // half floats may underflow to 0
#ifdef FACES
    vec4 face = texelFetch(faces, at, 0);
    float face_z = texelFetch(face_depths, at, 0).r;
    bool before_splats = face_z <= z + tolerance;
    over = before_splats ? face.a * face.rgb + (1.0 - face.a) * over : over + (1.0 - alpha) * face.a * face.rgb;
    if (face.a >= 0.5 && (before_splats || alpha < 0.5)) z = face_z;
    alpha = 1.0 - (1.0 - face.a) * (1.0 - alpha);
#endif
#ifdef BELOW
    vec3 under = texelFetch(below, at, 0).rgb;
    vec2 before = texelFetch(below_info, at, 0).xy;
    float before_group = floor(before.y * 0.5);
    float before_alpha = before.y - 2.0 * before_group;
    vec3 mixed = z <= before.x ? over + (1.0 - alpha) * under
                               : under + (1.0 - before_alpha) * (over - alpha * background);
    frame = vec4(mixed, 1.0);
    bool nearer = z < before.x || (before_group < 0.0 && alpha > 0.0);
    float both = 1.0 - (1.0 - alpha) * (1.0 - before_alpha);
    info = vec2(min(z, before.x), 2.0 * (nearer ? group : before_group) + both);
#else
    frame = vec4(over + (1.0 - alpha) * background, 1.0);
    info = vec2(z, alpha > 0.0 ? 2.0 * group + alpha : -2.0);
#endif
}
