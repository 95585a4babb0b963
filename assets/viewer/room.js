// Light, and a chair for each of several heads round a table.

import * as THREE from "three";

const TABLE = 0.72, SEAT = 0.45, EYES = 1.18; // heights, metres
const BACK = 0.35; // chair behind the face

export function light(scene) {
    scene.add(new THREE.HemisphereLight(0xdfe8ff, 0x57483c, 1.3));
    for (const [x, y, z, strength] of [[1.5, 2.5, 3, 1.9], [-3, 1, 2, 0.7], [0, 2, -3, 0.8]]) {
        const lamp = new THREE.DirectionalLight(0xffffff, strength);
        lamp.position.set(x, y, z);
        scene.add(lamp);
    }
}

const wood = () => new THREE.MeshStandardMaterial({ color: 0x7a5638, roughness: 0.7 });

function box(width, height, depth, x, y, z, material) {
    const mesh = new THREE.Mesh(new THREE.BoxGeometry(width, height, depth), material);
    mesh.position.set(x, y, z);
    return mesh;
}

function chair(material) {
    const group = new THREE.Group(), half = 0.2;
    group.add(box(0.44, 0.04, 0.44, 0, SEAT, 0, material), box(0.44, 0.5, 0.04, 0, SEAT + 0.27, -half, material));
    for (const x of [-half, half]) for (const z of [-half, half]) group.add(box(0.04, SEAT, 0.04, x, SEAT / 2, z, material));
    return group;
}

// Place heads: one alone with its face at the origin, several on chairs round a table, whose middle is the origin.
// Returns the group, and where a camera that sees all of it stands and looks.
export function seat(heads) {
    const group = new THREE.Group();
    if (heads.length === 1) {
        group.add(heads[0]);
        heads[0].position.set(0, 0, 0);
        heads[0].rotation.set(0, 0, 0);
        return { group, eye: new THREE.Vector3(0, 0.03, 0.66), target: new THREE.Vector3(0, 0.01, 0), height: 0 };
    }
    const material = wood(), radius = Math.max(0.55, 0.16 * heads.length), away = radius + 0.2;
    const top = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 0.04, 48), material);
    const leg = new THREE.Mesh(new THREE.CylinderGeometry(0.06, 0.09, TABLE, 24), material);
    top.position.y = TABLE;
    leg.position.y = TABLE / 2;
    group.add(top, leg);
    heads.forEach((head, i) => {
        // The viewer has a place, too: the nearest one.
        const angle = 2 * Math.PI * (i + 1) / (heads.length + 1);
        const x = Math.sin(angle), z = Math.cos(angle), own = chair(material);
        head.position.set(away * x, EYES, away * z);
        own.position.set((away + BACK * 0.5) * x, 0, (away + BACK * 0.5) * z);
        head.rotation.y = own.rotation.y = angle + Math.PI;
        group.add(head, own);
    });
    return {
        group, eye: new THREE.Vector3(0, EYES + 0.35, away + 0.9), target: new THREE.Vector3(0, EYES - 0.2, 0), height: EYES,
    };
}
