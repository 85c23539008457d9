// Lines and sheets over the frame; they show faintly where the object is in front.
uniform sampler2D info;   // the frame's depths
uniform float tolerance;  // world units: overlays that lie on the object are not hidden by it
uniform float hidden;     // share of the opacity that is left behind the object
uniform float width;      // pixels; 0: a sheet
#ifdef PICTURE
uniform sampler2D picture;
#endif

in float depth;
in vec4 tint;
noperspective in float across;

layout(location = 0) out vec4 colour;

void main() {
    float front = texelFetch(info, ivec2(gl_FragCoord.xy), 0).r;
#ifdef PICTURE
    vec4 shown = texture(picture, tint.xy);
#else
    vec4 shown = tint;
#endif
    float alpha = shown.a * (depth <= front + tolerance ? 1.0 : hidden);
    if (width > 0.0) alpha *= clamp(0.5 * width + 0.5 - abs(across), 0.0, 1.0);
    colour = vec4(shown.rgb, alpha);
}
