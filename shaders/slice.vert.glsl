// An atom where a cut plane meets it: a quad that lies in the plane.
#include "camera.glsl"
#include "shape.glsl"

in vec3 mean;
#ifdef ELLIPSOID
in vec3 scale;
in vec4 quat;
in vec3 dc;
#else
in float sigma;
in vec3 rgb;
#endif
in vec2 corner; // -1 or 1

uniform vec4 cut;      // the plane in object space
uniform vec3 cut_x;    // two unit vectors in the plane
uniform vec3 cut_y;
uniform float enlarge;

flat out vec3 centre;  // camera space
flat out vec4 colour;  // rgb; weight at the centre
#ifdef ELLIPSOID
flat out mat3 whiten;  // of camera space
#else
flat out float spread; // standard deviation
#endif

void main() {
    centre = (view * vec4(mean, 1.0)).xyz;
    float distance = dot(cut.xyz, mean) + cut.w;
    vec3 foot = mean - distance * cut.xyz;
    float z = (view * vec4(foot, 1.0)).z;
    // Half sizes along cut_x and cut_y of the splat's section, and its middle relative to the centre's projection onto the plane (foot).
    vec2 extent = vec2(0.0), middle = vec2(0.0);
#ifdef ELLIPSOID
    vec3 enlarged = scale * enlarge;
    vec3 used = max(enlarged, vec3(0.5 * footprint_at(max(z, near))));
    vec3 ratio = enlarged / used;
    colour = vec4(max(0.5 + SH_C0 * dc, 0.0), ratio.x * ratio.y * ratio.z);
    mat3 axes = rotation_of(quat);
    mat3 inverse_axes = transpose(mat3(axes[0] / used.x, axes[1] / used.y, axes[2] / used.z));
    whiten = inverse_axes * transpose(mat3(view));
    // The section of q = |W (foot - mean + x e1 + y e2)|^2 <= CUTOFF_Q, a conic in x and y.
    vec3 a = inverse_axes * cut_x, b = inverse_axes * cut_y, d = inverse_axes * (foot - mean);
    float aa = dot(a, a), ab = dot(a, b), bb = dot(b, b);
    vec3 n = cross(a, b);
    float det = dot(n, n);
    if (det > 0.0) {
        middle = vec2(ab * dot(b, d) - bb * dot(a, d), ab * dot(a, d) - aa * dot(b, d)) / det;
        vec3 rest = d + middle.x * a + middle.y * b;
        float left = CUTOFF_Q - dot(rest, rest);
        if (left > 0.0) extent = sqrt(left * vec2(bb, aa) / det) * 1.01;
    }
#else
    spread = sigma * enlarge;
    colour = vec4(rgb, 1.0);
    // A little more than the largest footprint within the splat; fragments compute theirs exactly.
    float used = max(spread, 1.1 * 0.5 * footprint_at(max(z, near)));
    float left = CUTOFF_Q * used * used - distance * distance;
    if (left > 0.0) extent = vec2(sqrt(left));
#endif
    if (extent.x <= 0.0) {
        gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
        return;
    }
    vec2 at = middle + corner * extent;
    gl_Position = clip_position((view * vec4(foot + at.x * cut_x + at.y * cut_y, 1.0)).xyz);
}
