// Real spherical harmonics in INRIA's order and signs. SH_VECTORS vec4 hold the coefficients one after the other,
// three channels each.
in vec4 sh[SH_VECTORS];

#define AT(i) sh[(i) / 4][(i) % 4]
#define COEFFICIENT(k) vec3(AT(3 * (k)), AT(3 * (k) + 1), AT(3 * (k) + 2))

vec3 sh_colour(vec3 d) {
    vec3 c = 0.5 + 0.28209479177387814 * COEFFICIENT(0);
#if SH_DEGREE >= 1
    float x = d.x, y = d.y, z = d.z;
    c += 0.4886025119029199 * (-y * COEFFICIENT(1) + z * COEFFICIENT(2) - x * COEFFICIENT(3));
#endif
#if SH_DEGREE >= 2
    float xx = x * x, yy = y * y, zz = z * z;
    c += 1.0925484305920792 * (x * y * COEFFICIENT(4) - y * z * COEFFICIENT(5) - x * z * COEFFICIENT(7));
    c += 0.31539156525252005 * (2.0 * zz - xx - yy) * COEFFICIENT(6);
    c += 0.5462742152960396 * (xx - yy) * COEFFICIENT(8);
#endif
#if SH_DEGREE >= 3
    c += -0.5900435899266435 * (y * (3.0 * xx - yy) * COEFFICIENT(9) + x * (xx - 3.0 * yy) * COEFFICIENT(15));
    c += 2.890611442640554 * x * y * z * COEFFICIENT(10);
    c += -0.4570457994644658 * (4.0 * zz - xx - yy) * (y * COEFFICIENT(11) + x * COEFFICIENT(13));
    c += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * COEFFICIENT(12);
    c += 1.445305721320277 * z * (xx - yy) * COEFFICIENT(14);
#endif
    return max(c, 0.0);
}
