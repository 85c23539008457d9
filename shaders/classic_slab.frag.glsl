// A slab of a capture, blended by itself, for blending it under what lies before it.
uniform sampler2D lights;
uniform sampler2D depths;
uniform vec2 slab; // its nearest depth and thickness, world units

layout(location = 0) out vec4 light;
layout(location = 1) out vec4 depth;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    light = texelFetch(lights, at, 0);
    if (light.a == 0.0) discard; // blending full floats costs more than all else here
    depth = vec4(slab.x * light.a + slab.y * texelFetch(depths, at, 0).r, 0.0, 0.0, light.a);
}
