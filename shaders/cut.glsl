// Where a pixel's ray meets the cut plane, camera space: from the plane's equation, so that all passes agree on it.
uniform vec4 cut_in_camera;

vec3 hit(vec2 pixel) {
    vec3 origin = origin_of(pixel), ray = ray_of(pixel);
    float z = -(dot(cut_in_camera.xyz, origin) + cut_in_camera.w) / dot(cut_in_camera.xyz, ray);
    return origin + z * ray;
}
