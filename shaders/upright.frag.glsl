// The finished frame, whose first row is the top one, on a canvas, whose first row is the lowest.
uniform sampler2D frame;
uniform vec2 size; // width, height in pixels

layout(location = 0) out vec4 colour;

void main() {
    colour = texelFetch(frame, ivec2(gl_FragCoord.x, size.y - gl_FragCoord.y), 0);
}
