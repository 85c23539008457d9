// One projected atom as a quad along its axes.
#include "camera.glsl"

in vec4 record_centre;
in vec4 record_conic;
in vec4 record_shape;
in vec4 record_colour;
in vec2 corner; // -1 or 1

#ifndef CLASSIC
uniform float reach;        // in standard deviations: all of the splat, or its core
#endif

flat out vec4 centre;
flat out vec4 conic;
flat out vec2 depth_slope;
flat out vec3 colour;

void main() {
    centre = record_centre;
    conic = record_conic;
    depth_slope = record_shape.xy;
    colour = record_colour.rgb;
    if (record_shape.z <= 0.0) {
        gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside of the clip volume
        return;
    }
#ifdef CLASSIC
    float reach = sqrt(max(0.0, 2.0 * log(ALPHA_STEPS * centre.w))); // where opacity falls to 1 / ALPHA_STEPS
#endif
    vec2 major = vec2(cos(record_shape.w), sin(record_shape.w));
    vec2 half_axes = reach * vec2(record_shape.z, record_colour.w) + 0.1;
    vec2 u = corner.x * half_axes.x * major + corner.y * half_axes.y * vec2(-major.y, major.x);
#ifdef CLASSIC
    gl_Position = vec4(to_ndc(centre.xy + u), 0.0, 1.0);
#else
    // w = 1 makes depth linear over the quad, which is what the splat's is: the early depth test stays on.
    float z = centre.z + dot(depth_slope, u);
    gl_Position = vec4(to_ndc(centre.xy + u), linear_depth(z) * 2.0 - 1.0, 1.0);
#endif
}
