// A line of constant width on the screen (LINE: one instance each), or a corner of a flat sheet, plain or with a
// picture on it (PICTURE).
#include "camera.glsl"

#ifdef LINE
in vec2 corner; // -1 or 1: along, across
in vec3 start;
in vec3 end;
#else
in vec3 position;
#endif
#ifdef PICTURE
in vec2 place; // in the picture, 0 to 1
#else
in vec4 rgba;
#endif

uniform float width; // pixels

out float depth;
out vec4 tint; // PICTURE: the place in it, twice
noperspective out float across; // pixels from the line's middle

void main() {
#ifdef PICTURE
    tint = vec4(place, place);
#else
    tint = rgba;
#endif
    across = 0.0;
#ifdef LINE
    vec3 a = (view * vec4(start, 1.0)).xyz, b = (view * vec4(end, 1.0)).xyz;
#ifndef ORTHOGRAPHIC
    // Clip the part behind the near plane.
    if (a.z < near && b.z < near) {
        gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
        depth = 0.0;
        return;
    }
    if (a.z < near) a = mix(a, b, (near - a.z) / (b.z - a.z));
    if (b.z < near) b = mix(b, a, (near - b.z) / (a.z - b.z));
#endif
    vec4 p = clip_position(a), q = clip_position(b);
    vec2 run = (q.xy / q.w - p.xy / p.w) * size;
    run = dot(run, run) > 0.0 ? normalize(run) : vec2(1.0, 0.0);
    vec4 here = corner.x < 0.0 ? p : q;
    float reach = 0.5 * width + 1.0;
    across = corner.y * reach;
    here.xy += (vec2(-run.y, run.x) * across) / size * 2.0 * here.w;
    gl_Position = here;
    depth = corner.x < 0.0 ? a.z : b.z;
#else
    vec3 c = (view * vec4(position, 1.0)).xyz;
    gl_Position = clip_position(c);
    depth = c.z;
#endif
}
