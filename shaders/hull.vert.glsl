// A cut plane's polygon within its piece.
in vec3 position; // object space
uniform mat4 view;
uniform vec4 lens;
uniform vec2 size;

void main() {
    vec3 c = (view * vec4(position, 1.0)).xyz;
#ifdef ORTHOGRAPHIC
    vec2 pixel = lens.xy * c.xy + lens.zw;
    gl_Position = vec4(pixel / size * 2.0 - 1.0, 0.0, 1.0);
#else
    vec2 scaled = lens.xy * c.xy + lens.zw * c.z; // pixel times depth
    gl_Position = vec4(scaled / size * 2.0 - c.z, 0.0, c.z);
#endif
}
