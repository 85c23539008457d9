// Classic 3DGS (Kerbl et al. 2023), blended front to back: each layer leaves less transmittance for the next.
flat in vec4 centre;
flat in vec4 conic;
flat in vec3 colour;

uniform vec2 slab; // nearest depth of what is drawn and its thickness, world units

layout(location = 0) out vec4 light; // colour, opacity
layout(location = 1) out vec4 depth; // in the slab, opacity in alpha

void main() {
    vec2 u = gl_FragCoord.xy - centre.xy;
    float q = conic.x * u.x * u.x + 2.0 * conic.y * u.x * u.y + conic.z * u.y * u.y;
    float alpha = min(MAX_ALPHA, centre.w * exp(-0.5 * q));
    if (!(alpha >= 1.0 / ALPHA_STEPS)) discard;
    light = vec4(alpha * colour, alpha);
    depth = vec4(alpha * (centre.z - slab.x) / slab.y, 0.0, 0.0, alpha);
}
