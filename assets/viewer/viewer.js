// The page: it connects, loads the heads, and draws them.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Avatar } from "./avatar.js";
import { Immersion, whyNot } from "./immersive.js";
import { RelayStream } from "./relay.js";
import { light, seat } from "./room.js";
import { Stream } from "./stream.js";
import { text } from "./texts.js";

const RATE_OVER = 1000; // milliseconds
const TURN = Math.PI / 36, CLOSER = 0.9; // by one press of a key: radians, and share of the distance
const KEYS = {
    ArrowLeft: [-TURN, 0, 1], ArrowRight: [TURN, 0, 1], ArrowUp: [0, -TURN, 1], ArrowDown: [0, TURN, 1],
    "+": [0, 0, CLOSER], "=": [0, 0, CLOSER], "-": [0, 0, 1 / CLOSER], _: [0, 0, 1 / CLOSER],
};
const place = (name) => document.getElementById(name);
const write = (name, words) => place(name).textContent === words || (place(name).textContent = words);

class Viewer {
    constructor() {
        this.renderer = new THREE.WebGLRenderer({ canvas: place("picture"), antialias: true, alpha: true });
        this.renderer.xr.enabled = true;
        this.scene = new THREE.Scene();
        this.scene.background = new THREE.Color(0x23262b);
        light(this.scene);
        this.camera = new THREE.PerspectiveCamera(30, 1, 0.01, 50);
        this.controls = new OrbitControls(this.camera, this.renderer.domElement);
        this.controls.enableDamping = true;
        this.controls.addEventListener("change", () => (this.stale = true));
        this.stale = true; // whether the picture has to be drawn again
        this.avatars = [];
        this.room = this.loaded = null;
        this.updates = this.drawn = this.shown = 0;
        this.rate = this.latency = null;
        this._counted = { at: performance.now(), updates: 0 };
        const { relay, password } = document.documentElement.dataset;
        const own = new URL("stream", location.href).href.replace(/^http/, "ws");
        this.stream = relay ? new RelayStream(relay, password) : new Stream(own);
        place("reset").textContent = text("reset");
        place("reset").onclick = () => this.frame();
        place("picture").ariaLabel = text("view");
        place("picture").onkeydown = (event) => this.press(event);
        const name = () => (place("immersive").textContent = text(this.renderer.xr.isPresenting ? "leave" : "immersive"));
        name();
        this.renderer.xr.addEventListener("sessionstart", name);
        this.renderer.xr.addEventListener("sessionend", name);
        this.renderer.xr.addEventListener("sessionend", () => this.leave());
        for (const button of document.querySelectorAll("button")) button.addEventListener("beforexrselect", (event) => event.preventDefault());
        this.immersion = null;
        this.reason = ""; // why there is no augmented reality
        place("immersive").onclick = () => this.immerse();
        whyNot().then((reason) => {
            place("immersive").hidden = reason !== "";
            this.reason = reason && text(reason);
        });
        this.renderer.setAnimationLoop((_, frame) => this.draw(frame));
    }

    // Put the camera where it sees everything.
    frame() {
        if (!this.room) return;
        const { eye, target, wide } = this.room;
        this.camera.position.copy(eye).sub(target).multiplyScalar(Math.max(1, wide / this.camera.aspect)).add(target);
        this.controls.target.copy(target);
        this.controls.update();
    }

    // Orbit and zoom by keys.
    press(event) {
        if (!this.room || event.ctrlKey || event.metaKey || event.altKey) return;
        if (event.key === "Home") this.frame();
        else if (event.key in KEYS) this.orbit(...KEYS[event.key]);
        else return;
        event.preventDefault();
    }

    // Turn the camera round what it looks at, and change its distance by a factor.
    orbit(aside, down, factor) {
        const { target } = this.controls;
        const way = new THREE.Spherical().setFromVector3(this.camera.position.clone().sub(target));
        way.set(way.radius * factor, way.phi + down, way.theta + aside).makeSafe();
        this.camera.position.setFromSpherical(way).add(target);
        this.controls.update();
    }

    async immerse() {
        if (this.immersion) return this.immersion.session.end();
        try {
            const session = await Immersion.ask(document.querySelector("footer"));
            this.immersion = new Immersion(this.renderer, this.scene, session);
            this.reason = "";
            await this.immersion.begin();
        } catch (error) {
            this.leave();
            this.reason = error.message;
        }
    }

    leave() {
        this.immersion?.restore(this.room);
        this.immersion = null;
        this.stale = true;
    }

    draw(xr) {
        const { scene } = this.stream;
        if (scene && scene !== this.loaded) this.load(scene);
        const frame = this.room && !this.loading ? this.stream.take() : null;
        if (frame && frame.scene === this.loaded.scene) this.show(frame);
        this.resize();
        if (!this.renderer.xr.isPresenting) this.controls.update();
        else if (xr && this.room) this.immersion?.update(xr, this.room);
        if (this.stale || this.renderer.xr.isPresenting) {
            this.stale = false;
            this.renderer.render(this.scene, this.camera);
            this.drawn++;
        }
        this.tell();
    }

    show({ view, offset, heads, taken, number }) {
        for (const avatar of this.avatars.slice(0, heads)) {
            if (offset + avatar.bytes > view.byteLength) return;
            avatar.show(view, offset);
            avatar.compute(this.renderer);
            offset += avatar.bytes;
        }
        this.shown = number;
        this.updates++;
        this.stale = true;
        this.latency = this.stream.since(taken);
    }

    // Load the heads of another scene. Those of the last one stay until all are there.
    async load(scene) {
        this.loaded = scene;
        if (!scene.images.length) return;
        this.loading = scene;
        try {
            const avatars = await Promise.all(scene.images.map((count, i) => this.head(`${scene.path}/${i}`, count)));
            if (this.loading !== scene) return avatars.forEach((avatar) => avatar.dispose());
            this.place(avatars);
        } catch (error) {
            if (this.stream.scene === scene) place("message").textContent = this.failure = error.message;
        }
        if (this.loading === scene) this.loading = null;
    }

    async head(path, count) {
        const load = async (name) => {
            const answer = await fetch(`${path}/${name}`);
            if (!answer.ok) throw new Error(text("gone"));
            return answer;
        };
        const image = async (number) => createImageBitmap(await (await load(number)).blob(), { imageOrientation: "flipY" });
        const [data, ...images] = await Promise.all([
            load("model").then((answer) => answer.arrayBuffer()),
            ...Array.from({ length: count }, (_, number) => image(number)),
        ]);
        return new Avatar(this.renderer, data, images);
    }

    place(avatars) {
        const first = !this.room || avatars.length !== this.avatars.length;
        if (this.room) this.scene.remove(this.room.group);
        this.avatars.forEach((avatar) => avatar.dispose());
        this.avatars = avatars;
        this.room = seat(avatars.map(({ object }) => object));
        this.scene.add(this.room.group);
        document.title = `${avatars.map(({ name }) => name).join(", ")} – Facemime`;
        this.stale = true;
        if (first) this.frame();
    }

    resize() {
        const { clientWidth, clientHeight } = this.renderer.domElement, ratio = Math.min(devicePixelRatio, 2);
        const size = `${clientWidth}x${clientHeight}x${ratio}`;
        if (this.renderer.xr.isPresenting || size === this.size) return;
        this.size = size;
        this.renderer.setPixelRatio(ratio);
        this.renderer.setSize(clientWidth, clientHeight, false);
        this.camera.aspect = clientWidth / Math.max(clientHeight, 1);
        this.camera.updateProjectionMatrix();
        this.stale = true;
    }

    // Frame rate and latency once a second, and what is missing.
    tell() {
        const now = performance.now(), { at, updates } = this._counted;
        if (now - at > RATE_OVER) {
            this.rate = (1000 * (this.updates - updates)) / (now - at);
            this._counted = { at: now, updates: this.updates };
            const parts = [`${this.rate.toFixed(0)} ${text("rate")}`];
            if (this.latency !== null && this.rate > 0) parts.push(`${Math.max(this.latency, 0).toFixed(0)} ms`);
            place("numbers").textContent = this.avatars.length ? parts.join("   ") : "";
        }
        const waiting = this.failure && this.loaded === this.stream.scene ? this.failure : this.room ? "" : text("waiting");
        const message = this.stream.connected ? waiting : text("lost");
        write("message", message);
        const places = this.immersion?.finds && !this.immersion.place;
        write("reason", places ? text("place").replace("\n", " ") : this.reason);
    }
}

try {
    globalThis.viewer = new Viewer();
} catch (error) {
    place("message").textContent = `${text("graphics")} (${error.message})`;
}
