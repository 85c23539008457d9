// Divides what the passes added up for pieces that lie together, and puts it into the frame by depth.
#include "camera.glsl"

uniform sampler2D splats;    // weighted rgb, weight
uniform sampler2D sharpness; // weighted sharpness
uniform sampler2D front;     // linear depth
uniform sampler2D faces;     // rgb, coverage
uniform sampler2D face_depths;
uniform sampler2D below;     // the frame so far
uniform sampler2D below_info;
uniform vec3 background;
uniform float tolerance;     // world units: a splat that the plane cuts is not in front of the face
uniform float group;
uniform int has_faces;
uniform int has_below;

layout(location = 0) out vec4 frame;
layout(location = 1) out vec4 info; // depth, group, coverage

const float NOTHING = 3.0e38;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 sum = texelFetch(splats, at, 0);
    float buffer = texelFetch(front, at, 0).r;
    float z = buffer < 1.0 ? buffer / depth_range.y + depth_range.x : NOTHING;
    vec3 colour = vec3(0.0);
    float alpha = 0.0;
    if (sum.a > MIN_WEIGHT) {
        colour = sum.rgb / sum.a;
        alpha = clamp(0.5 + (sum.a - 0.5) * texelFetch(sharpness, at, 0).r / sum.a, 0.0, 1.0);
    }
    vec3 over = alpha * colour; // premultiplied
    if (has_faces != 0) {
        vec4 face = texelFetch(faces, at, 0);
        float face_z = texelFetch(face_depths, at, 0).r;
        if (face.a > 0.0) {
            if (face_z <= z + tolerance) {
                over = face.a * face.rgb + (1.0 - face.a) * over;
                if (face.a >= 0.5) z = face_z;
            } else {
                over += (1.0 - alpha) * face.a * face.rgb;
                if (alpha < 0.5 && face.a >= 0.5) z = face_z;
            }
            alpha = 1.0 - (1.0 - face.a) * (1.0 - alpha);
        }
    }
    vec3 under = background;
    vec4 before = vec4(NOTHING, -1.0, 0.0, 0.0);
    if (has_below != 0) {
        under = texelFetch(below, at, 0).rgb;
        before = texelFetch(below_info, at, 0);
    }
    if (z <= before.x) {
        frame = vec4(over + (1.0 - alpha) * under, 1.0);
    } else {
        frame = vec4(under + (1.0 - before.z) * (over - alpha * background), 1.0);
    }
    bool nearer = z < before.x || (before.y < 0.0 && alpha > 0.0);
    info = vec4(min(z, before.x), nearer ? group : before.y, 1.0 - (1.0 - alpha) * (1.0 - before.z), 0.0);
}
