// EWA projection of one ellipsoid, captured by transform feedback: computed once a frame, drawn in two passes.
#include "camera.glsl"
#include "shape.glsl"
#include "sh.glsl"

in vec3 mean;
in vec3 scale;
in vec4 quat;
#ifdef CLASSIC
in float opacity;
#endif

uniform vec4 slope_limits; // x low, x high, y low, y high: x / z and y / z are clamped to these for the Jacobian
uniform float enlarge;     // 1, or more for a coarser level of detail
#ifdef CULLED
uniform int plane_count;
uniform vec4 planes[MAX_PLANES]; // camera space; what lies beyond one is not drawn
#endif
#ifdef CLASSIC
uniform float strength;    // factor of the opacity
#endif

out vec4 record_centre; // pixel x, y, depth, weight (opaque) or opacity (classic)
out vec4 record_conic;  // q = a dx^2 + 2 b dx dy + c dy^2, then the edge's sharpness
out vec4 record_shape;  // depth slope along x and y, half axis in pixels (0: not drawn), its angle
out vec4 record_colour; // rgb, the other half axis in pixels

void main() {
    record_centre = record_conic = record_shape = record_colour = vec4(0.0);
    vec3 c = (view * vec4(mean, 1.0)).xyz;
    if (!(c.z > near)) return;
#ifdef CULLED
    float radius = sqrt(CUTOFF_Q) * enlarge * max(scale.x, max(scale.y, scale.z)) + 4.0 * footprint_at(c.z);
    for (int j = 0; j < plane_count; j++)
        if (dot(planes[j].xyz, c) + planes[j].w > radius) return;
#endif
#ifdef ORTHOGRAPHIC
    vec2 slope = vec2(0.0);
    vec2 zoom = lens.xy;
    vec2 centre = lens.xy * c.xy + lens.zw;
    vec3 direction = eye;
#else
    vec2 slope = clamp(c.xy / c.z, slope_limits.xz, slope_limits.yw);
    vec2 zoom = lens.xy / c.z;
    vec2 centre = zoom * c.xy + lens.zw;
    vec3 direction = normalize(mean - eye);
#endif
    mat3 axes = mat3(view) * rotation_of(quat);
    axes[0] *= scale.x * enlarge;
    axes[1] *= scale.y * enlarge;
    axes[2] *= scale.z * enlarge;
    vec3 along = vec3(axes[0].z, axes[1].z, axes[2].z);
    vec3 bx = zoom.x * (vec3(axes[0].x, axes[1].x, axes[2].x) - slope.x * along);
    vec3 by = zoom.y * (vec3(axes[0].y, axes[1].y, axes[2].y) - slope.y * along);
    // Determinants from the cross product: flat and enormous ellipsoids lose no digits.
    vec3 normal = cross(bx, by);
    float det0 = dot(normal, normal);
    float xx = dot(bx, bx), xy = dot(bx, by), yy = dot(by, by);
    float det = det0 + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
    xx += LOW_PASS;
    yy += LOW_PASS;
    float middle = 0.5 * (xx + yy);
    float largest = middle + length(vec2(0.5 * (xx - yy), xy));
    float least = det / largest;
#ifdef CLASSIC
    float reach = sqrt(max(0.0, 2.0 * log(ALPHA_STEPS * strength * opacity)) * largest);
    if (!(reach > 0.0)) return;
#else
    float reach = sqrt(CUTOFF_Q * largest);
#endif
    if (!(reach < 1e9)) return; // not finite, or so near that the projection has no meaning
    if (any(lessThan(centre, vec2(-reach))) || any(greaterThan(centre, size + reach))) return;

    record_conic = vec4(yy / det, -xy / det, xx / det, max(1.0, sqrt(least) / EDGE_SLOPE));
    vec2 covariance = vec2(dot(bx, along), dot(by, along));
    vec2 k = vec2(record_conic.x * covariance.x + record_conic.y * covariance.y,
                  record_conic.y * covariance.x + record_conic.z * covariance.y);
    float angle = abs(xy) + abs(xx - yy) > 0.0 ? 0.5 * atan(2.0 * xy, xx - yy) : 0.0;
#ifdef CLASSIC
    record_centre = vec4(centre, c.z, strength * opacity);
#else
    record_centre = vec4(centre, c.z, sqrt(det0 / det));
#endif
    record_shape = vec4(k, sqrt(largest), angle);
    record_colour = vec4(sh_colour(direction), sqrt(least));
}
