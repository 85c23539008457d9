// An interior atom on a grid that lies in a cut plane. Its distance from the plane gives a factor; in the plane it is a
// round Gaussian, narrowed by as much as linear interpolation of the grid will widen it.
in vec3 mean;
in float sigma;
in vec3 rgb;

uniform vec4 cut;
uniform vec3 cut_x;
uniform vec3 cut_y;
uniform vec2 low;      // plane coordinates of the grid's corner
uniform float cell;    // world units
uniform vec2 cells;
uniform float enlarge;

flat out vec3 shape;   // centre in cells, 1 / (2 sigma^2) in cells^-2
flat out vec4 colour;
flat out float limit;  // squared reach in cells

void main() {
    float enlarged = sigma * enlarge;
    float distance = dot(cut.xyz, mean) + cut.w;
    float narrowed = enlarged * enlarged - cell * cell / 6.0; // the variance of the interpolation's hat function
    vec2 at = (vec2(dot(cut_x, mean), dot(cut_y, mean)) - low) / cell;
    shape = vec3(at, 0.5 * cell * cell / narrowed);
    colour = vec4(rgb, 1.0) * exp(-0.5 * distance * distance / (enlarged * enlarged)) * enlarged * enlarged / narrowed;
    limit = (CUTOFF_Q * enlarged * enlarged - distance * distance) / (cell * cell);
    gl_PointSize = limit > 0.0 ? 2.0 * sqrt(limit) + 2.0 : 1.0;
    gl_Position = limit > 0.0 ? vec4(at / cells * 2.0 - 1.0, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}
