// The composited capture over the background.
uniform sampler2D lights;
uniform sampler2D depths;
uniform vec3 background;

layout(location = 0) out vec4 frame;
layout(location = 1) out vec2 info; // as in resolve.frag.glsl

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 sum = texelFetch(lights, at, 0);
    frame = vec4(sum.rgb + (1.0 - sum.a) * background, 1.0);
    bool seen = sum.a > 0.0;
    info = vec2(seen ? texelFetch(depths, at, 0).r / sum.a : NOTHING, seen ? min(sum.a, 1.0) : -2.0);
}
