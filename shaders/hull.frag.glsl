// Where each pixel's ray meets the cut plane, in object space, from the plane's equation; and through which plane.
#include "camera.glsl"

uniform vec4 plane; // camera space
uniform float index;

layout(location = 0) out vec4 point;

void main() {
    vec3 origin = origin_of(gl_FragCoord.xy), ray = ray_of(gl_FragCoord.xy);
    float z = -(dot(plane.xyz, origin) + plane.w) / dot(plane.xyz, ray);
#ifndef ORTHOGRAPHIC
    if (!(z > near)) discard;
#endif
    // A rigid view is undone by its transpose.
    point = vec4(transpose(mat3(view)) * (origin + z * ray - view[3].xyz), index);
}
