// Real spherical harmonics in INRIA's order and signs. The coefficients are packed into SH_VECTORS vec4, three
// channels each.
#ifdef GL_ES
SH_INPUTS // GLSL ES has no arrays among a vertex's inputs: sh_0, sh_1, ...
#else
in vec4 sh[SH_VECTORS];
#endif

#define AT(i) sh[(i) / 4][(i) % 4]
#define COEFFICIENT(k) vec3(AT(3 * (k)), AT(3 * (k) + 1), AT(3 * (k) + 2))

#ifndef SH_DEGREE // some compilers take no undefined name for 0
#define SH_DEGREE 0
#endif

vec3 sh_colour(vec3 d) {
#ifdef GL_ES
    vec4 sh[SH_VECTORS] = SH_UNPACKED;
#endif
    vec3 c = 0.5 + SH_C0 * COEFFICIENT(0);
#if SH_DEGREE >= 1
    float x = d.x, y = d.y, z = d.z;
    c += SH_C1 * (-y * COEFFICIENT(1) + z * COEFFICIENT(2) - x * COEFFICIENT(3));
#endif
#if SH_DEGREE >= 2
    float xx = x * x, yy = y * y, zz = z * z;
    c += SH_C2_0 * (x * y * COEFFICIENT(4) - y * z * COEFFICIENT(5) - x * z * COEFFICIENT(7));
    c += SH_C2_2 * (2.0 * zz - xx - yy) * COEFFICIENT(6);
    c += SH_C2_4 * (xx - yy) * COEFFICIENT(8);
#endif
#if SH_DEGREE >= 3
    c += SH_C3_0 * (y * (3.0 * xx - yy) * COEFFICIENT(9) + x * (xx - 3.0 * yy) * COEFFICIENT(15));
    c += SH_C3_1 * x * y * z * COEFFICIENT(10);
    c += SH_C3_2 * (4.0 * zz - xx - yy) * (y * COEFFICIENT(11) + x * COEFFICIENT(13));
    c += SH_C3_3 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * COEFFICIENT(12);
    c += SH_C3_5 * z * (xx - yy) * COEFFICIENT(14);
#endif
    return max(c, 0.0);
}
