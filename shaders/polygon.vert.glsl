// A cut plane's polygon within its piece.
#include "camera.glsl"

in vec3 position; // object space

void main() {
    gl_Position = clip_position((view * vec4(position, 1.0)).xyz);
}
