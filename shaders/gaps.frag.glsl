// Where something behind the layer at the front can show: depth 1 there and 0 elsewhere, for a depth test.
#include "camera.glsl"
#include "outside_look.glsl"

uniform sampler2D in_layer;
uniform sampler2D rims;
uniform sampler2D edges;
uniform sampler2D front;
#ifdef FACES
uniform sampler2D faces;
uniform sampler2D face_depths;
uniform float tolerance;
#endif

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 edge = texelFetch(edges, at, 0);
    float layer = texelFetch(in_layer, at, 0).a;
    float covered = 1.0 - (1.0 - coverage(texelFetch(rims, at, 0).a, edge.y)) * (1.0 - coverage(layer, edge.x));
#ifdef FACES
    bool hidden = texelFetch(faces, at, 0).a >= FACE_OPAQUE
        && texelFetch(face_depths, at, 0).r <= depth_at(texelFetch(front, at, 0).r) + tolerance;
#else
    bool hidden = false;
#endif
    gl_FragDepth = layer > MIN_WEIGHT && covered < SHUT && !hidden ? 1.0 : 0.0;
}
