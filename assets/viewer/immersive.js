// Augmented reality, where the browser and the device have it: what is shown stands on a real surface.

import * as THREE from "three";
import { text } from "./texts.js";

const AWAY = 0.8, BELOW = 0.1, ROUND = 1.3; // metres from the viewer's eyes to a single face, and to a table, at first
const FLOOR = 1.1; // metres below the eyes: surfaces below are floors, those above are tables, for who sits or stands
const LEVEL = 0.9; // smallest cosine between a surface's normal and the vertical: walls and slopes carry nothing
const AIMED = 0.1; // metres from the first point from which on a second one gives a direction
const UP = new THREE.Vector3(0, 1, 0);

// Why there is no augmented reality here, as a key of the texts; "" if there is.
export async function whyNot() {
    // No browser of an iPhone or iPad has WebXR; on an iPad, Safari says that it is a Mac, which has no touch screen.
    if (/iPhone|iPad|iPod/.test(navigator.userAgent) || (navigator.platform === "MacIntel" && navigator.maxTouchPoints > 1)) return "iphone";
    if (!window.isSecureContext) return "insecure";
    if (!navigator.xr) return "unknown";
    try {
        return (await navigator.xr.isSessionSupported("immersive-ar")) ? "" : "unsupported";
    } catch {
        return "unsupported";
    }
}

// A session in which presses place the room: at the point that is aimed at, facing the viewer, or, if a second point is
// aimed at before the release, with its front towards that. Two people who use the same two points see the same place.
export class Immersion {
    // `overlay` is what a phone shows of the page in the session.
    static ask(overlay) {
        return navigator.xr.requestSession("immersive-ar", {
            optionalFeatures: ["dom-overlay", "hit-test", "anchors"],
            domOverlay: { root: overlay },
        });
    }

    constructor(renderer, scene, session) {
        this.renderer = renderer;
        this.scene = scene;
        this.session = session;
        this.place = null; // where the room stands: Matrix4, y up, its front towards +z; null until it has been placed
        this.on = "nothing"; // or "table" or "floor"
        this._first = null; // the hit test's result at that place
        this._anchor = this._offset = null; // what holds it there, and the place as seen from the anchor
        this._sources = new Map(); // the hit tests: that of the viewer's line of sight, and one for each pointer
        this._used = this._pressed = null; // the pointer that was used last; the press that goes on
        this._background = scene.background;
        scene.background = null;
        this._mark = mark();
        this._sign = session.domOverlayState ? null : sign(text("place"));
        scene.add(this._mark);
        if (this._sign) scene.add(this._sign);
        session.addEventListener("inputsourceschange", ({ added, removed }) => {
            removed.forEach((input) => this._forget(input));
            added.filter(({ targetRayMode }) => targetRayMode === "tracked-pointer").forEach((input) => this._look(input.targetRaySpace, input));
        });
        session.addEventListener("selectstart", ({ inputSource }) => this._press(this._sources.has(inputSource) ? inputSource : null));
        session.addEventListener("selectend", () => this._pressed && (this._pressed.over = true));
    }

    // Whether the device finds surfaces.
    get finds() {
        return this._sources.size > 0;
    }

    async begin() {
        this.renderer.xr.setReferenceSpaceType("local");
        await this.renderer.xr.setSession(this.session);
        await this._look(await this.session.requestReferenceSpace("viewer"));
    }

    // Put everything back as it was on the page.
    restore(room) {
        this.scene.background = this._background;
        this.scene.remove(this._mark);
        if (this._sign) this.scene.remove(this._sign);
        room.stand("nothing");
        room.group.position.set(0, 0, 0);
        room.group.quaternion.identity();
    }

    // Move the room to its place; `frame` is the session's.
    update(frame, room) {
        const space = this.renderer.xr.getReferenceSpace(), viewer = frame.getViewerPose(space);
        if (!viewer) return; // the device does not know where it is, for the moment
        const eyes = vector(viewer.transform.position), hit = this._hit(frame, space);
        this._mark.visible = hit !== null && (!this.place || this._pressed !== null);
        if (hit) this._mark.position.copy(hit.point);
        if (hit && this._pressed) this._aim(hit, eyes);
        if (this._sign) this._point(hit, eyes);
        if (this._pressed?.over) this._pressed = null;
        this._follow(frame, space);
        const { group, height, stand } = room, raise = stand(this.on);
        if (this.place) this.place.decompose(group.position, group.quaternion, new THREE.Vector3());
        // The origin is where the viewer's eyes were at the start.
        else group.position.set(0, height ? -height : -BELOW, height ? -ROUND : -AWAY);
        if (this.place) group.translateY(-raise);
    }

    async _look(space, input = null) {
        try {
            const source = await this.session.requestHitTestSource?.({ space });
            if (source) this._sources.set(input, source);
        } catch (error) {
            console.info(`No surfaces are found here: ${error.message}`); // the room stays in front of the viewer
        }
    }

    _forget(input) {
        this._sources.get(input)?.cancel();
        this._sources.delete(input);
        if (this._used === input) this._used = null;
        if (this._pressed?.input === input) this._pressed = null;
    }

    _press(input) {
        this._used = input;
        this._pressed = { input, first: null, aimed: false, over: false };
    }

    // The level surface that is aimed at: by the pressed pointer, else by the last one that was used, or any; else by the viewer.
    _hit(frame, space) {
        const order = this._pressed ? [this._pressed.input] : [...[this._used, ...this._sources.keys()].filter(Boolean), null];
        for (const source of order.map((input) => this._sources.get(input)).filter(Boolean)) {
            for (const result of frame.getHitTestResults(source)) {
                const matrix = new THREE.Matrix4().fromArray(result.getPose(space)?.transform.matrix ?? []);
                if (new THREE.Vector3().setFromMatrixColumn(matrix, 1).dot(UP) > LEVEL) {
                    return { result, point: new THREE.Vector3().setFromMatrixPosition(matrix) };
                }
            }
        }
        return null;
    }

    // The first point of a press is the place. Its front is towards the last point that is far enough from it.
    _aim({ result, point }, eyes) {
        const pressed = this._pressed;
        if (!pressed.first) {
            pressed.first = point;
            this.on = eyes.y - point.y > FLOOR ? "floor" : "table";
            this._hold(result);
        }
        const aimed = level(point, pressed.first).length() > AIMED;
        if (pressed.aimed && !aimed) return;
        pressed.aimed = aimed;
        const front = level(aimed ? point : eyes, pressed.first);
        this.place = new THREE.Matrix4().makeRotationY(Math.atan2(front.x, front.z)).setPosition(pressed.first);
        this._offset = null;
    }

    // Ask for an anchor, with which the place stays where it is when the device corrects its map of the room.
    async _hold(result) {
        this._first = result;
        this._anchor?.delete();
        this._anchor = null;
        try {
            const anchor = await result.createAnchor?.();
            if (this._first !== result) anchor?.delete();
            else this._anchor = anchor ?? null;
        } catch (error) {
            console.info(`No anchor here: ${error.message}`); // the place stays by the device's map alone
        }
    }

    _follow(frame, space) {
        const pose = this._anchor && frame.trackedAnchors?.has(this._anchor) ? frame.getPose(this._anchor.anchorSpace, space) : null;
        if (!pose || !this.place) return;
        const anchor = new THREE.Matrix4().fromArray(pose.transform.matrix);
        if (this._offset) this.place.multiplyMatrices(anchor, this._offset);
        else this._offset = anchor.invert().multiply(this.place);
    }

    // Hold the sign above the surface that is aimed at, or in front of the viewer, until something has been placed.
    _point(hit, eyes) {
        this._sign.visible = !this.place && this.finds;
        this._sign.position.copy(hit ? hit.point : new THREE.Vector3(0, -0.35, -1));
        this._sign.position.y += hit ? 0.2 : 0;
        this._sign.lookAt(eyes);
    }
}

const vector = ({ x, y, z }) => new THREE.Vector3(x, y, z);
const level = (to, from) => to.clone().sub(from).setY(0);

// A ring where the pointer meets a surface.
function mark() {
    const mesh = new THREE.Mesh(new THREE.RingGeometry(0.035, 0.045, 48).rotateX(-Math.PI / 2), new THREE.MeshBasicMaterial({ color: 0xffffff }));
    mesh.visible = false;
    return mesh;
}

// Words in the room, for headsets, which show nothing of the page.
function sign(words) {
    const canvas = document.createElement("canvas"), context = canvas.getContext("2d");
    canvas.width = 1024;
    canvas.height = 160;
    context.fillStyle = "#23262bd0";
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.fillStyle = "#e8e8e8";
    context.font = "42px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    words.split("\n").forEach((line, i, { length }) => context.fillText(line, canvas.width / 2, canvas.height * ((i + 1) / (length + 1)), canvas.width - 40));
    const map = new THREE.CanvasTexture(canvas);
    map.colorSpace = THREE.SRGBColorSpace;
    return new THREE.Mesh(new THREE.PlaneGeometry(0.64, 0.1), new THREE.MeshBasicMaterial({ map, transparent: true }));
}
