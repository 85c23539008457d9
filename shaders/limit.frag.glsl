// The far end of the layer at the front, for a depth test; a hair farther, since splats decide for themselves.
#include "camera.glsl"

uniform sampler2D front;
uniform float layer; // its depth, world units

void main() {
    gl_FragDepth = texelFetch(front, ivec2(gl_FragCoord.xy), 0).r + 1.001 * layer * depth_range.y;
}
