// What the graphics card computes for each vertex, as core/drive/driver.py does it for Blender.

const COMMON = `
precision highp float;
precision highp int;
precision highp sampler2D;
ivec2 at(int index, int width) { return ivec2(index % width, index / width); }
int mine(int width) { return int(gl_FragCoord.y) * width + int(gl_FragCoord.x); }
`;

export const FILL = `
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }
`;

// rest + W d + sum a_k M_k, and lids that slide over the eyeballs; the result is the offset from rest.
export const SKIN = `${COMMON}
uniform sampler2D rest, spheres, weights, modes;
uniform vec3 moved[max(4 * FOURS, 1)];
uniform vec4 amounts[(AMOUNTS + 4) / 4];
out vec4 offset;
void main() {
    int vertex = mine(WIDTH);
    offset = vec4(0.0);
    if (vertex >= COUNT) return;
    vec3 sum = vec3(0.0);
    for (int k = 0; k < FOURS; k++) {
        vec4 w = texelFetch(weights, at(vertex * FOURS + k, WIDE), 0);
        sum += w.x * moved[4 * k] + w.y * moved[4 * k + 1] + w.z * moved[4 * k + 2] + w.w * moved[4 * k + 3];
    }
    for (int k = 0; k < AMOUNTS; k++) {
        float amount = amounts[k >> 2][k & 3];
        if (amount != 0.0) sum += amount * texelFetch(modes, at(vertex * AMOUNTS + k, WIDE), 0).xyz;
    }
    vec3 start = texelFetch(rest, at(vertex, WIDTH), 0).xyz;
    vec4 sphere = texelFetch(spheres, at(vertex, WIDTH), 0);
    vec3 outward = start + sum - sphere.xyz;
    if (length(outward) < sphere.w * 0.999995) {
        float height = outward.y / sphere.w;
        vec3 along = outward * vec3(1.0, height * height, 1.0);
        float product = dot(along, outward), lacking = sphere.w * sphere.w - dot(outward, outward);
        float pushed = lacking / max(product + sqrt(product * product + dot(along, along) * lacking), 1e-20);
        sum = sphere.xyz + outward + pushed * along - start;
    }
    offset.xyz = sum;
}
`;

// Every vertex: of the skin, of what turns, of what rides on the skin, of the tongue, of gums that stay behind the skin.
export const PARTS = `${COMMON}
uniform sampler2D rest, follows, skin, tongues, riding, roots, gums;
uniform mat3 turns[3];
uniform vec3 pivots[3];
uniform float tongue;
out vec4 offset;
vec3 turned(vec3 point, int which) { return pivots[which] + turns[which] * (point - pivots[which]); }
vec3 rode(vec3 start, int point) {
    vec4 middle = texelFetch(riding, at(point, WIDTH), 0);
    vec3 shift = vec3(0.0), turn = vec3(0.0);
    for (int k = 0; k < NEIGHBOURS; k++) {
        int first = (int(middle.w) * NEIGHBOURS + k) * 3;
        vec4 x = texelFetch(roots, at(first, WIDE), 0);
        vec4 y = texelFetch(roots, at(first + 1, WIDE), 0);
        vec4 z = texelFetch(roots, at(first + 2, WIDE), 0);
        vec3 moved = texelFetch(skin, at(int(x.w), WIDTH), 0).xyz;
        shift += y.w * moved;
        turn += vec3(dot(x.xyz, moved), dot(y.xyz, moved), dot(z.xyz, moved));
    }
    vec3 arm = start - middle.xyz;
    float size = length(turn), sine = min(size, 1.0);
    vec3 axis = turn / max(size, 1e-12);
    vec3 along = dot(axis, arm) * axis;
    return middle.xyz + shift + along + sqrt(1.0 - sine * sine) * (arm - along) + sine * cross(axis, arm);
}
float least(int point, vec2 across) {
    vec4 corners = texelFetch(gums, at(3 * point, WIDTH), 0), weights = texelFetch(gums, at(3 * point + 1, WIDTH), 0);
    vec3 slopes = texelFetch(gums, at(3 * point + 2, WIDTH), 0).xyz, moved = vec3(0.0);
    for (int k = 0; k < 3; k++) moved += weights[k] * texelFetch(skin, at(int(corners[k]), WIDTH), 0).xyz;
    vec2 beside = across - moved.xy;
    return corners.w + moved.z + dot(slopes.xy, beside) + slopes.z * length(beside);
}
void main() {
    int vertex = mine(WIDTH);
    offset = vec4(0.0);
    if (vertex >= COUNT) return;
    vec2 follow = texelFetch(follows, at(vertex, WIDTH), 0).xy;
    int kind = int(follow.x), source = int(follow.y);
    vec3 start = texelFetch(rest, at(vertex, WIDTH), 0).xyz;
    if (kind == 1) offset.xyz = texelFetch(skin, at(source, WIDTH), 0).xyz;
    else if (kind >= 2 && kind <= 4) offset.xyz = turned(start, kind - 2) - start;
    else if (kind == 5) offset.xyz = rode(start, source) - start;
    else if (kind == 6) offset.xyz = turned(start + tongue * texelFetch(tongues, at(source, WIDTH), 0).xyz, 2) - start;
    else if (kind == 7) {
        vec3 place = turned(start, 2);
        offset.xyz = vec3(place.xy, max(place.z, least(source, place.xy - start.xy))) - start;
    }
}
`;

// Sum of the normals of the faces round a vertex, each as long as its face is large.
export const NORMALS = `${COMMON}
uniform sampler2D rest, offsets, rings, spans;
out vec4 normal;
vec3 place(int vertex) {
    ivec2 where = at(vertex, WIDTH);
    return texelFetch(rest, where, 0).xyz + texelFetch(offsets, where, 0).xyz;
}
void main() {
    int group = mine(WIDTH);
    normal = vec4(0.0, 0.0, -1.0, 0.0);
    if (group >= GROUPS) return;
    vec3 span = texelFetch(spans, at(group, WIDTH), 0).xyz;
    int first = int(span.x), last = first + int(span.y);
    vec3 here = place(int(span.z)), sum = vec3(0.0);
    for (int k = first; k < last; k++) {
        vec2 pair = texelFetch(rings, at(k, WIDE), 0).xy;
        sum += cross(place(int(pair.x)) - here, place(int(pair.y)) - here);
    }
    float size = length(sum);
    if (size > 0.0) normal.xyz = sum / size;
}
`;

// Replaces the position and the normal in three.js's own shaders.
export function deformed(shader, uniforms, width) {
    Object.assign(shader.uniforms, uniforms);
    shader.vertexShader = shader.vertexShader
        .replace("#include <common>", `#include <common>
            uniform sampler2D facemimeOffsets, facemimeNormals;
            attribute float row, group;
            ivec2 facemimeAt(float index) { int i = int(index); return ivec2(i % ${width}, i / ${width}); }`)
        .replace("#include <beginnormal_vertex>",
            "vec3 objectNormal = texelFetch(facemimeNormals, facemimeAt(group), 0).xyz;")
        .replace("#include <begin_vertex>",
            "vec3 transformed = position + texelFetch(facemimeOffsets, facemimeAt(row), 0).xyz;");
}
