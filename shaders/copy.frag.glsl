// Copies one frame to the other.
uniform sampler2D colour;
uniform sampler2D info;

layout(location = 0) out vec4 frame;
layout(location = 1) out vec2 frame_info;

void main() {
    frame = texelFetch(colour, ivec2(gl_FragCoord.xy), 0);
    frame_info = texelFetch(info, ivec2(gl_FragCoord.xy), 0).xy;
}
