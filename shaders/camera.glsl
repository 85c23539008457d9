// The view of one piece: object space (relative to the object's centre) to camera space, OpenCV axes. Pixels count from the
// top left; framebuffers store the top row first, so gl_FragCoord is the pixel.
uniform mat4 view;
uniform vec4 lens;        // fx, fy, cx, cy in pixels (orthographic: pixels per world unit)
uniform vec2 size;        // width, height in pixels
uniform vec3 eye;         // object space; orthographic: the viewing direction
uniform float near;       // least depth that is drawn; orthographic: far below anything
uniform vec2 depth_range; // z0, 1 / (z1 - z0): the linear depth buffer

// The direction of a pixel's ray in camera axes, scaled to one unit of depth.
vec3 ray_of(vec2 pixel) {
#ifdef ORTHOGRAPHIC
    return vec3(0.0, 0.0, 1.0);
#else
    return vec3((pixel - lens.zw) / lens.xy, 1.0);
#endif
}

vec3 origin_of(vec2 pixel) {
#ifdef ORTHOGRAPHIC
    return vec3((pixel - lens.zw) / lens.xy, 0.0);
#else
    return vec3(0.0);
#endif
}

vec3 point_at(vec2 pixel, float z) {
    return origin_of(pixel) + z * ray_of(pixel);
}

float linear_depth(float z) {
    return (z - depth_range.x) * depth_range.y;
}

float depth_at(float linear) {
    return linear / depth_range.y + depth_range.x;
}

// World units that one pixel spans at depth z.
float footprint_at(float z) {
#ifdef ORTHOGRAPHIC
    return inversesqrt(lens.x * lens.y);
#else
    return z * inversesqrt(lens.x * lens.y);
#endif
}

vec2 to_ndc(vec2 pixel) {
    return pixel / size * 2.0 - 1.0;
}

// Clip position of a point in camera space, without a depth: depth tests use the linear depth instead.
vec4 clip_position(vec3 p) {
#ifdef ORTHOGRAPHIC
    return vec4(to_ndc(lens.xy * p.xy + lens.zw), 0.0, 1.0);
#else
    return vec4((lens.xy * p.xy + lens.zw * p.z) / size * 2.0 - p.z, 0.0, p.z);
#endif
}
