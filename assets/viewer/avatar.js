// A head on the graphics card: textures that are loaded once, and three passes for each frame.

import * as THREE from "three";
import { FILL, NORMALS, PARTS, SKIN, deformed } from "./shaders.js";

const WIDTH = 1024; // of textures with one texel for each vertex
const WIDE = 4096; // of textures with several
const EYE_DISTANCE = 0.09; // metres, for every head
const KINDS = { f2: Uint16Array, f4: Float32Array, u1: Uint8Array, u4: Uint32Array };
const DISPLACEMENT = 2 ** -14, AMOUNT = 2 ** -13; // steps
const POSE = 16; // numbers

const filled = new THREE.Mesh(new THREE.BufferGeometry(), null);
filled.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3));
filled.frustumCulled = false;
const eye = new THREE.Camera();

function unpack(data) {
    const view = new DataView(data);
    if (view.getUint32(0) !== 0x464d564d) throw new Error("not a head");
    const start = 8 + view.getUint32(4, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, start - 8)));
    const arrays = {};
    for (const [name, [kind, offset, size]] of Object.entries(header.arrays)) {
        arrays[name] = new KINDS[kind](data, start + offset, size);
    }
    return { header, arrays };
}

function texture(source, channels, width, half = false) {
    const count = Math.ceil(source.length / channels), rows = Math.max(1, Math.ceil(count / width));
    const data = new (half ? Uint16Array : Float32Array)(4 * width * rows);
    if (channels === 4) data.set(source);
    else for (let i = 0; i < count; i++) for (let c = 0; c < channels; c++) data[4 * i + c] = source[channels * i + c];
    const made = new THREE.DataTexture(data, width, rows, THREE.RGBAFormat, half ? THREE.HalfFloatType : THREE.FloatType);
    made.needsUpdate = true;
    return made;
}

// For each group of vertices that share a normal, the other two corners of the triangles round it.
function rings(rows, triangles, groups, count) {
    const starts = new Uint32Array(count + 1);
    for (const corner of triangles) starts[groups[rows[corner]] + 1]++;
    for (let g = 0; g < count; g++) starts[g + 1] += starts[g];
    const pairs = new Float32Array(2 * triangles.length), next = starts.slice(0, count);
    const spans = new Float32Array(3 * count);
    for (let t = 0; t < triangles.length; t += 3) {
        for (let c = 0; c < 3; c++) {
            const here = rows[triangles[t + c]], at = next[groups[here]]++;
            pairs[2 * at] = rows[triangles[t + (c + 1) % 3]];
            pairs[2 * at + 1] = rows[triangles[t + (c + 2) % 3]];
            spans[3 * groups[here] + 2] = here;
        }
    }
    for (let g = 0; g < count; g++) {
        spans[3 * g] = starts[g];
        spans[3 * g + 1] = starts[g + 1] - starts[g];
    }
    return { pairs, spans };
}

function interleaved(kinds, sources) {
    const both = new Float32Array(2 * kinds.length);
    for (let i = 0; i < kinds.length; i++) {
        both[2 * i] = kinds[i];
        both[2 * i + 1] = sources[i];
    }
    return both;
}

function turn(target, [x, y, z]) {
    const angle = Math.hypot(x, y, z);
    const axis = angle > 0 ? new THREE.Vector3(x / angle, y / angle, z / angle) : new THREE.Vector3(1, 0, 0);
    return target.setFromMatrix4(new THREE.Matrix4().makeRotationAxis(axis, angle));
}

export class Avatar {
    // `images` are bitmaps, in the order of the header's numbers.
    constructor(renderer, data, images) {
        const { header, arrays } = unpack(data);
        this.header = header;
        this.name = header.name;
        this.landmarks = header.columns ? 66 : 0;
        this.bytes = 4 * POSE + 4 * Math.ceil((3 * this.landmarks + header.amounts) / 2);
        this.vertices = arrays.rest.length / 3;
        this.rest = arrays.rest;
        this._passes(renderer, arrays);
        this._tree(arrays, images);
        this.show(new DataView(new ArrayBuffer(this.bytes)), 0);
        this.compute(renderer);
    }

    // Take a frame over from a message.
    show(view, offset) {
        const number = (i) => view.getFloat32(offset + 4 * i, true);
        const pose = Array.from({ length: POSE }, (_, i) => number(i));
        const turns = this.parts.uniforms.turns.value;
        turn(turns[0], pose.slice(6, 9));
        turn(turns[1], pose.slice(9, 12));
        turn(turns[2], pose.slice(3, 6));
        this.parts.uniforms.tongue.value = pose[15];
        const [x, y, z] = pose, angle = Math.hypot(x, y, z);
        if (angle > 0) this.neck.quaternion.setFromAxisAngle(new THREE.Vector3(x, y, z).divideScalar(angle), angle);
        else this.neck.quaternion.identity();
        this.neck.position.fromArray(this.header.neck).add(new THREE.Vector3(...pose.slice(12, 15)));
        let at = offset + 4 * POSE;
        const moved = this.skin.uniforms.moved.value, amounts = this.skin.uniforms.amounts.value;
        for (let i = 0; i < 3 * this.landmarks; i++, at += 2) {
            moved[i] = view.getInt16(at, true) * DISPLACEMENT * this.header.unit;
        }
        for (let i = 0; i < this.header.amounts; i++, at += 2) amounts[i] = view.getInt16(at, true) * AMOUNT;
    }

    // Compute offsets and normals of all vertices.
    compute(renderer) {
        const { xr } = renderer, before = renderer.getRenderTarget(), immersive = xr.enabled;
        xr.enabled = false;
        for (const [material, target] of [[this.skin, this.skinTarget], [this.parts, this.target], [this.normals, this.normalTarget]]) {
            filled.material = material;
            renderer.setRenderTarget(target);
            renderer.render(filled, eye);
        }
        renderer.setRenderTarget(before);
        xr.enabled = immersive;
    }

    // All vertices as the graphics card has them, head frame, without the pose of the head.
    read(renderer) {
        const { width, height } = this.target, values = new Float32Array(4 * width * height);
        renderer.readRenderTargetPixels(this.target, 0, 0, width, height, values);
        return Float32Array.from(this.rest, (start, i) => start + values[4 * Math.floor(i / 3) + (i % 3)]);
    }

    dispose() {
        for (const target of [this.skinTarget, this.target, this.normalTarget]) target.dispose();
        for (const owner of [this.skin, this.parts, this.normals]) {
            for (const { value } of Object.values(owner.uniforms)) if (value?.isTexture) value.dispose();
            owner.dispose();
        }
        this.mesh.geometry.dispose();
        for (const material of this.mesh.material) {
            material.map?.dispose();
            material.dispose();
        }
    }

    _passes(renderer, arrays) {
        const { columns, amounts, pivots } = this.header, skin = arrays.skin.length / 3;
        const texels = Math.max(skin * columns / 4, skin * amounts, arrays.triangles.length);
        const { maxTextureSize } = renderer.capabilities;
        if (maxTextureSize < WIDE || texels / WIDE > maxTextureSize) throw new Error("This head is too large for the graphics card");
        const rest = texture(arrays.rest, 3, WIDTH);
        this.skinTarget = this._target(renderer, skin);
        this.target = this._target(renderer, this.vertices);
        this.skin = this._pass(SKIN, { COUNT: skin, FOURS: columns / 4, AMOUNTS: amounts }, {
            rest: texture(arrays.skin, 3, WIDTH),
            spheres: texture(arrays.spheres, 4, WIDTH),
            weights: texture(arrays.weights, 4, WIDE, true),
            modes: texture(arrays.modes, 4, WIDE, true),
            moved: new Float32Array(3 * Math.max(columns, 1)),
            amounts: new Float32Array(4 * Math.floor((amounts + 4) / 4)),
        });
        const around = (name) => new THREE.Vector3(...(pivots[name] ?? [0, 0, 0]));
        this.parts = this._pass(PARTS, { COUNT: this.vertices, NEIGHBOURS: arrays.roots ? this._neighbours(arrays) : 0 }, {
            rest,
            follows: texture(interleaved(arrays.kinds, arrays.sources), 2, WIDTH),
            skin: this.skinTarget.texture,
            tongues: texture(arrays.tongue, 3, WIDTH),
            riding: texture(arrays.riding ?? [], 4, WIDTH),
            roots: texture(arrays.roots ?? [], 4, WIDE),
            gums: texture(arrays.gums ?? [], 4, WIDTH),
            turns: [0, 1, 2].map(() => new THREE.Matrix3()),
            pivots: [around("eye_right"), around("eye_left"), around("jaw")],
            tongue: 0,
        });
        this.groups = new Float32Array(this.vertices);
        const numbers = new Map();
        for (let i = 0; i < this.vertices; i++) {
            const key = arrays.kinds[i] === 1 ? arrays.sources[i] : skin + i;
            if (!numbers.has(key)) numbers.set(key, numbers.size);
            this.groups[i] = numbers.get(key);
        }
        const { pairs, spans } = rings(arrays.rows, arrays.triangles, this.groups, numbers.size);
        this.normalTarget = this._target(renderer, numbers.size);
        this.normals = this._pass(NORMALS, { GROUPS: numbers.size }, {
            rest,
            offsets: this.target.texture,
            rings: texture(pairs, 2, WIDE),
            spans: texture(spans, 3, WIDTH),
        });
    }

    _neighbours(arrays) {
        let most = 0;
        for (let i = 3; i < arrays.riding.length; i += 4) most = Math.max(most, arrays.riding[i]);
        return arrays.roots.length / 12 / (most + 1);
    }

    _target(renderer, count) {
        const exact = renderer.extensions.has("EXT_color_buffer_float");
        const type = exact ? THREE.FloatType : THREE.HalfFloatType;
        return new THREE.WebGLRenderTarget(WIDTH, Math.max(1, Math.ceil(count / WIDTH)), {
            type, depthBuffer: false, minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter,
        });
    }

    _pass(fragmentShader, defines, values) {
        const uniforms = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, { value }]));
        return new THREE.ShaderMaterial({
            glslVersion: THREE.GLSL3, vertexShader: FILL, fragmentShader, uniforms, defines: { WIDTH, WIDE, ...defines },
            depthTest: false, depthWrite: false,
        });
    }

    // object: metres, y up, facing +z, the face at its origin; neck: turns; below it the head frame.
    _tree(arrays, images) {
        const { neck, face, unit } = this.header;
        this.object = new THREE.Group();
        const frame = new THREE.Group(), placed = new THREE.Group();
        this.neck = new THREE.Group();
        frame.rotation.x = Math.PI;
        frame.scale.setScalar(EYE_DISTANCE / unit);
        placed.position.fromArray(face).negate();
        this.object.add(frame.add(placed.add(this.neck)));
        const geometry = this._geometry(arrays);
        const materials = this.header.surfaces.map((surface) => this._material(surface, images));
        this.mesh = new THREE.Mesh(geometry, materials);
        this.mesh.position.fromArray(neck).negate();
        this.mesh.frustumCulled = false;
        this.neck.add(this.mesh);
    }

    _geometry({ rest, rows, uv, triangles, sizes }) {
        const geometry = new THREE.BufferGeometry();
        const position = new Float32Array(3 * rows.length), group = new Float32Array(rows.length);
        rows.forEach((row, i) => {
            for (let c = 0; c < 3; c++) position[3 * i + c] = rest[3 * row + c];
            group[i] = this.groups[row];
        });
        geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
        geometry.setAttribute("normal", new THREE.BufferAttribute(new Float32Array(3 * rows.length), 3));
        geometry.setAttribute("row", new THREE.BufferAttribute(Float32Array.from(rows), 1));
        geometry.setAttribute("group", new THREE.BufferAttribute(group, 1));
        geometry.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
        geometry.setIndex(new THREE.BufferAttribute(triangles, 1));
        let first = 0;
        sizes.forEach((size, i) => {
            geometry.addGroup(first, 3 * size, i);
            first += 3 * size;
        });
        return geometry;
    }

    _material({ colour, roughness, image, alpha }, images) {
        const material = new THREE.MeshStandardMaterial({ roughness, side: THREE.DoubleSide });
        if (image < 0) material.color.setRGB(...colour);
        else {
            material.map = new THREE.Texture(images[image]);
            material.map.colorSpace = THREE.SRGBColorSpace;
            material.map.flipY = false;
            material.map.wrapS = material.map.wrapT = THREE.RepeatWrapping;
            material.map.anisotropy = 4;
            material.map.needsUpdate = true;
            material.transparent = alpha;
            material.alphaTest = alpha ? 0.02 : 0; // what is invisible hides nothing behind it
        }
        const uniforms = { facemimeOffsets: { value: this.target.texture }, facemimeNormals: { value: this.normalTarget.texture } };
        material.onBeforeCompile = (shader) => deformed(shader, uniforms, WIDTH);
        return material;
    }
}
