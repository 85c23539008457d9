// Depth 0 where what has been blended lets nothing more show and 1 elsewhere, for a depth test.
uniform sampler2D lights;

void main() {
    gl_FragDepth = 1.0 - texelFetch(lights, ivec2(gl_FragCoord.xy), 0).a < MIN_TRANSMITTANCE ? 0.0 : 1.0;
}
