// Light, what a single head stands on, and a chair for each of several heads round a sand table.

import * as THREE from "three";
import { sandTable } from "./terrain.js";

const TABLE = 0.72, SEAT = 0.45, EYES = 1.2, NECK = 0.1; // heights, metres; NECK is below the face
const TURN = 0.9; // radians between neighbours, unless there are too many
const SAND = 1.3; // edge of the sand table in radii of the table it stands on, whose corners it does not reach

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

// A chair that faces +z.
function chair(material) {
    const group = new THREE.Group(), half = 0.2;
    group.add(box(0.44, 0.04, 0.44, 0, SEAT, 0, material), box(0.44, 0.5, 0.04, 0, SEAT + 0.27, -half, material));
    for (const x of [-half, half]) for (const z of [-half, half]) group.add(box(0.04, SEAT, 0.04, x, SEAT / 2, z, material));
    return group;
}

// Shoulders for a head above them, from a height up.
function shoulders(bottom, material) {
    const round = 0.13, top = EYES - NECK - round, outline = [new THREE.Vector2(round, bottom)];
    for (let i = 0; i <= 12; i++) {
        const angle = (i / 12) * (Math.PI / 2);
        outline.push(new THREE.Vector2(round * Math.cos(angle), top + round * Math.sin(angle)));
    }
    const body = new THREE.Mesh(new THREE.LatheGeometry(outline, 32), material);
    body.scale.set(1.5, 1, 0.75);
    return body;
}

// A soft shadow on the surface below.
function shadow(radius) {
    const canvas = document.createElement("canvas"), size = (canvas.width = canvas.height = 128), half = size / 2;
    const context = canvas.getContext("2d"), fade = context.createRadialGradient(half, half, 0, half, half, half);
    fade.addColorStop(0, "#0009");
    fade.addColorStop(1, "#0000");
    context.fillStyle = fade;
    context.fillRect(0, 0, size, size);
    const material = new THREE.MeshBasicMaterial({ map: new THREE.CanvasTexture(canvas), transparent: true, depthWrite: false });
    const mesh = new THREE.Mesh(new THREE.PlaneGeometry(2 * radius, 2 * radius).rotateX(-Math.PI / 2), material);
    mesh.position.y = 0.002;
    return mesh;
}

// Place heads: one alone with its face at the origin, several on chairs round a sand table. Returns the group; where a
// camera that sees all of it stands and looks, if its picture is as wide for its height as `wide`; how high above the
// group's origin the faces are; and `stand`, which dresses the group for "nothing", a real "table" or the "floor" below
// it, and returns the height in the group at which that surface is.
export const seat = (heads) => (heads.length === 1 ? alone(heads[0]) : together(heads));

function alone(head) {
    const group = new THREE.Group();
    group.add(head);
    head.position.set(0, 0, 0);
    head.rotation.set(0, 0, 0);
    head.updateMatrixWorld(true);
    const bottom = new THREE.Box3().setFromObject(head).min.y, tall = EYES + bottom;
    const below = shadow(0.13), plinth = new THREE.Mesh(new THREE.CylinderGeometry(0.13, 0.15, tall, 48), wood());
    plinth.position.y = bottom - tall / 2;
    below.position.y += bottom;
    group.add(plinth, below);
    const stand = (on) => {
        plinth.visible = on === "floor";
        below.visible = on !== "nothing";
        return on === "floor" ? -EYES : bottom;
    };
    stand("nothing");
    return { group, eye: new THREE.Vector3(0, 0.03, 0.66), target: new THREE.Vector3(0, 0.01, 0), wide: 0.65, height: 0, stand };
}

function together(heads) {
    const group = new THREE.Group();
    const material = wood(), dress = cloth(), radius = Math.max(0.5, 0.13 * heads.length), away = radius + 0.15;
    const top = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 0.04, 64), material);
    const leg = new THREE.Mesh(new THREE.CylinderGeometry(0.06, 0.09, TABLE, 24), material);
    const sand = sandTable(SAND * radius, material), below = shadow(radius);
    top.position.y = TABLE - 0.02;
    leg.position.y = TABLE / 2;
    sand.position.y = TABLE;
    below.position.y += TABLE;
    // On a real table, nothing is below its surface, as the room's own things could not hide that.
    const sitting = new THREE.Group().add(top, leg), standing = new THREE.Group().add(below);
    group.add(...heads, sand, sitting, standing);
    // The place at +z is the viewer's.
    const turn = Math.min(TURN, (2 * Math.PI) / (heads.length + 1));
    heads.forEach((head, i) => {
        const angle = Math.PI + turn * (i - (heads.length - 1) / 2), x = Math.sin(angle), z = Math.cos(angle);
        head.position.set(away * x, EYES, away * z);
        const parts = [[chair(material), sitting], [shoulders(SEAT, dress), sitting], [shoulders(TABLE, dress), standing]];
        for (const [part, owner] of parts) {
            part.position.set((away + 0.1) * x, 0, (away + 0.1) * z);
            part.rotation.y = angle + Math.PI;
            owner.add(part);
        }
        head.rotation.y = angle + Math.PI;
    });
    const stand = (on) => {
        standing.visible = on === "table";
        sitting.visible = !standing.visible;
        return standing.visible ? TABLE : 0;
    };
    stand("nothing");
    const eye = new THREE.Vector3(0, EYES + 0.45, away + 1.2);
    return { group, eye, target: new THREE.Vector3(0, EYES - 0.3, -0.35 * away), wide: 1.3, height: EYES, stand };
}
