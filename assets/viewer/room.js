// Light, and a chair for each of several heads round a table.

import * as THREE from "three";

const TABLE = 0.72, SEAT = 0.45, EYES = 1.2, NECK = 0.1; // heights, metres; NECK is below the face
const TURN = 0.9; // radians between neighbours, unless there are too many

export function light(scene) {
    scene.add(new THREE.HemisphereLight(0xdfe8ff, 0x57483c, 1.3));
    for (const [x, y, z, strength] of [[1.5, 2.5, 3, 1.9], [-3, 1, 2, 0.7], [-1, 1, -3, 0.4]]) {
        const lamp = new THREE.DirectionalLight(0xffffff, strength);
        lamp.position.set(x, y, z);
        scene.add(lamp);
    }
}

const wood = () => new THREE.MeshStandardMaterial({ color: 0x7a5638, roughness: 0.7 });
const cloth = () => new THREE.MeshStandardMaterial({ color: 0x3d4d63, roughness: 0.9 });

function box(width, height, depth, x, y, z, material) {
    const mesh = new THREE.Mesh(new THREE.BoxGeometry(width, height, depth), material);
    mesh.position.set(x, y, z);
    return mesh;
}

// A chair that faces +z, and shoulders for a head above it.
function chair(material, dress) {
    const group = new THREE.Group(), half = 0.2, top = EYES - NECK, tall = top - SEAT;
    group.add(box(0.44, 0.04, 0.44, 0, SEAT, 0, material), box(0.44, 0.5, 0.04, 0, SEAT + 0.27, -half, material));
    for (const x of [-half, half]) for (const z of [-half, half]) group.add(box(0.04, SEAT, 0.04, x, SEAT / 2, z, material));
    const body = new THREE.Mesh(new THREE.CapsuleGeometry(0.13, tall - 0.26, 8, 24), dress);
    body.scale.set(1.5, 1, 0.75);
    body.position.set(0, SEAT + tall / 2, 0);
    group.add(body);
    return group;
}

// Place heads: one alone with its face at the origin, several on chairs round a table that stands on the floor at the
// origin. Returns the group, and where a camera that sees all of it stands and looks.
export function seat(heads) {
    const group = new THREE.Group();
    group.add(...heads);
    if (heads.length === 1) {
        heads[0].position.set(0, 0, 0);
        heads[0].rotation.set(0, 0, 0);
        return { group, eye: new THREE.Vector3(0, 0.03, 0.66), target: new THREE.Vector3(0, 0.01, 0), height: 0 };
    }
    const material = wood(), dress = cloth(), radius = Math.max(0.5, 0.13 * heads.length), away = radius + 0.15;
    const top = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 0.04, 64), material);
    const leg = new THREE.Mesh(new THREE.CylinderGeometry(0.06, 0.09, TABLE, 24), material);
    top.position.y = TABLE;
    leg.position.y = TABLE / 2;
    group.add(top, leg);
    // The place at +z is the viewer's.
    const turn = Math.min(TURN, (2 * Math.PI) / (heads.length + 1));
    heads.forEach((head, i) => {
        const angle = Math.PI + turn * (i - (heads.length - 1) / 2), x = Math.sin(angle), z = Math.cos(angle);
        const own = chair(material, dress);
        head.position.set(away * x, EYES, away * z);
        own.position.set((away + 0.1) * x, 0, (away + 0.1) * z);
        head.rotation.y = own.rotation.y = angle + Math.PI;
        group.add(own);
    });
    const eye = new THREE.Vector3(0, EYES + 0.25, away + 1.0);
    return { group, eye, target: new THREE.Vector3(0, EYES - 0.22, -0.4 * away), height: EYES };
}
