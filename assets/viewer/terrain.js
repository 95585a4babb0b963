// The sand table: a valley with a river and a lake, hills, woods, a road and a village, in a frame of wood.

import * as THREE from "three";

const CELLS = 120, RELIEF = 0.17; // cells along an edge; height of the highest peak as a share of the edge
const WALL = 0.022, RIM = 0.05; // thickness and height of the frame, shares of the edge
const TREES = 170, HOUSES = 9;
const PEAKS = [[-0.55, -0.62, 0.34, 1], [0.5, -0.55, 0.3, 0.8], [-0.05, -0.9, 0.25, 0.62], [0.68, 0.42, 0.26, 0.36], [-0.75, 0.3, 0.3, 0.3]];
const SAND = [0.8, 0.66, 0.43], MEADOW = [0.5, 0.56, 0.28], ROCK = [0.47, 0.4, 0.33], SNOW = [0.95, 0.95, 0.93];
const WATER = [0.16, 0.4, 0.58], ROAD = [0.86, 0.8, 0.68];

const smooth = (low, high, x) => THREE.MathUtils.smoothstep(x, low, high);
const between = (a, b, share) => a.map((value, i) => value + (b[i] - value) * share);

// The same numbers in every browser, so that everybody sees the same land.
function random(seed) {
    return () => {
        seed = (seed * 1664525 + 1013904223) >>> 0;
        return seed / 2 ** 32;
    };
}

// Positions are -1 to 1 to the right (u) and towards the viewer (v).
const river = (v) => 0.16 * Math.sin(2.6 * v + 0.5) + 0.05 * Math.sin(7 * v);
const road = (u) => 0.2 + 0.12 * Math.sin(2.8 * u + 0.6);
const lake = (u, v) => Math.hypot((u - river(0.72)) / 0.38, (v - 0.7) / 0.2);
const wet = (u, v) => Math.abs(u - river(v)) < 0.035 || lake(u, v) < 1;
const rough = (u, v) => 0.5 * Math.sin(5 * u + 1.7) * Math.sin(4.3 * v) + 0.3 * Math.sin(11 * u - 3 * v) * Math.sin(9 * v + 2) + 0.2 * Math.sin(19 * u + 7 * v) * Math.sin(17 * v - 5 * u);

// Height as a share of the highest peak.
function height(u, v) {
    const bank = smooth(0.03, 0.34, Math.abs(u - river(v))) * smooth(0.95, 1.7, lake(u, v));
    let peaks = 0;
    for (const [x, y, wide, tall] of PEAKS) peaks += tall * Math.exp(-((u - x) ** 2 + (v - y) ** 2) / wide ** 2);
    const ground = 0.16 + 0.05 * rough(u, v) + peaks * (1 + 0.16 * rough(2.3 * u, 2.3 * v));
    const way = 1 - 0.6 * (1 - smooth(0.03, 0.1, Math.abs(v - road(u))));
    return 0.05 + bank * Math.max(ground, 0.04) * way;
}

function colour(u, v, tall, steep) {
    if (wet(u, v)) return WATER;
    if (Math.abs(v - road(u)) < 0.022) return ROAD;
    let mixed = between(SAND, MEADOW, smooth(0.08, 0.2, tall) * (1 - smooth(0.3, 0.5, tall)));
    mixed = between(mixed, ROCK, smooth(0.9, 1.6, steep) * smooth(0.25, 0.45, tall));
    return between(mixed, SNOW, smooth(0.72, 0.8, tall));
}

// `edge` in metres; it stands on y = 0. The far side is -z.
export function sandTable(edge, wood) {
    const group = new THREE.Group(), half = edge / 2;
    const at = (u, v) => new THREE.Vector3(u * half, RELIEF * edge * height(u, v), v * half);
    group.add(land(edge, half), frame(edge, wood), woods(edge, at), ...village(edge, at));
    return group;
}

function land(edge, half) {
    const geometry = new THREE.PlaneGeometry(edge, edge, CELLS, CELLS).rotateX(-Math.PI / 2);
    const { position } = geometry.attributes, colours = new Float32Array(3 * position.count), step = 2 / CELLS;
    for (let i = 0; i < position.count; i++) {
        const u = position.getX(i) / half, v = position.getZ(i) / half, tall = height(u, v);
        const steep = Math.hypot(height(u + step, v) - tall, height(u, v + step) - tall) / step;
        position.setY(i, RELIEF * edge * tall);
        const { r, g, b } = new THREE.Color().setRGB(...colour(u, v, tall, steep), THREE.SRGBColorSpace);
        colours.set([r, g, b], 3 * i);
    }
    geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    geometry.computeVertexNormals();
    return new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.85 }));
}

function frame(edge, material) {
    const group = new THREE.Group(), wall = WALL * edge, tall = RIM * edge, away = edge / 2 + wall / 2;
    for (let side = 0; side < 4; side++) {
        const board = new THREE.Mesh(new THREE.BoxGeometry(edge + 2 * wall, tall, wall), material);
        board.position.set(away * Math.sin((side * Math.PI) / 2), tall / 2, away * Math.cos((side * Math.PI) / 2));
        board.rotation.y = (side * Math.PI) / 2;
        group.add(board);
    }
    return group;
}

// Many of the same thing; `spots` are { u, v, size, turn }.
function many(geometry, color, spots, at, lift = 0) {
    const mesh = new THREE.InstancedMesh(geometry, new THREE.MeshStandardMaterial({ color, roughness: 0.9 }), spots.length);
    const matrix = new THREE.Matrix4(), up = new THREE.Vector3(0, 1, 0);
    spots.forEach(({ u, v, size, turn }, i) => {
        const position = at(u, v).add(new THREE.Vector3(0, lift * size, 0));
        mesh.setMatrixAt(i, matrix.compose(position, new THREE.Quaternion().setFromAxisAngle(up, turn), new THREE.Vector3(size, size, size)));
    });
    return mesh;
}

function woods(edge, at) {
    const next = random(7), spots = [];
    while (spots.length < TREES) {
        const u = 1.9 * next() - 0.95, v = 1.9 * next() - 0.95, tall = height(u, v), size = 0.7 + 0.6 * next();
        const grows = tall > 0.12 && tall < 0.5 && Math.abs(v - road(u)) > 0.09 && rough(1.3 * u + 2, 1.3 * v) > 0;
        if (grows) spots.push({ u, v, size, turn: 0 });
    }
    const crown = new THREE.ConeGeometry(0.011 * edge, 0.036 * edge, 7).translate(0, 0.018 * edge, 0);
    return many(crown, 0x3f5a2c, spots, at);
}

// Houses along the road, and the bridge.
function village(edge, at) {
    const next = random(3), spots = [];
    for (let i = 0; i < HOUSES; i++) {
        const u = -0.78 + 0.062 * i, v = road(u) + (i % 2 ? 0.075 : -0.075);
        spots.push({ u, v, size: 0.8 + 0.4 * next(), turn: 0.3 * next() });
    }
    const wide = 0.03 * edge, wall = new THREE.BoxGeometry(1.2 * wide, 0.7 * wide, wide).translate(0, 0.35 * wide, 0);
    const roof = new THREE.CylinderGeometry(0.62 * wide, 0.62 * wide, 1.3 * wide, 3).rotateZ(Math.PI / 2).rotateX(-Math.PI / 2);
    roof.scale(1, 0.62, 1);
    const crossing = river(road(0)), deck = new THREE.Mesh(
        new THREE.BoxGeometry(0.1 * edge, 0.008 * edge, 0.03 * edge), new THREE.MeshStandardMaterial({ color: 0x8a8078 }),
    );
    deck.position.copy(at(crossing, road(crossing))).add(new THREE.Vector3(0, 0.012 * edge, 0));
    return [many(wall, 0xe9dfcc, spots, at), many(roof, 0x9c4a33, spots, at, 0.85 * wide), deck];
}
