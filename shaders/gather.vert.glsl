// Copies indexed atoms into a contiguous buffer: instanced draws cannot index.
in vec3 mean;
out vec3 gathered_mean;
#ifdef ELLIPSOID
in vec3 scale;
in vec4 quat;
in vec3 dc;
out vec3 gathered_scale;
out vec4 gathered_quat;
out vec3 gathered_dc;
#else
in float sigma;
in vec3 rgb;
out float gathered_sigma;
out vec3 gathered_rgb;
#endif

void main() {
    gathered_mean = mean;
#ifdef ELLIPSOID
    gathered_scale = scale;
    gathered_quat = quat;
    gathered_dc = dc;
#else
    gathered_sigma = sigma;
    gathered_rgb = rgb;
#endif
}
