// What tests ask of an emulated headset.

// Put the headset or a controller somewhere, in the world, so that it looks at a point.
globalThis.pose = (target, position, at) => {
    const [x, y, z] = position.map((start, i) => at[i] - start), yaw = Math.atan2(-x, -z) / 2;
    const pitch = Math.atan2(y, Math.hypot(x, z)) / 2, [a, b, c, d] = [Math.sin(yaw), Math.cos(yaw), Math.sin(pitch), Math.cos(pitch)];
    target.position.set(...position);
    target.quaternion.set(b * c, a * d, -a * c, b * d);
};

// Move an anchor, as a device does that corrects its map of the room.
globalThis.shift = (anchor, way) => {
    const space = anchor.anchorSpace, hidden = Object.getOwnPropertySymbols(space).find(({ description }) => description === "@iwer/xr-space");
    way.forEach((distance, i) => (space[hidden].offsetMatrix[12 + i] += distance));
};

// Position and rotation of an object of the page in the real room, column by column.
globalThis.inWorld = (object) => {
    const { x, y, z, w } = headset.quaternion, { position } = headset;
    const head = new DOMMatrix([
        1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
        2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
        2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
        position.x, position.y, position.z, 1,
    ]);
    const camera = new DOMMatrix(viewer.camera.matrixWorld.elements);
    return Array.from(head.multiply(camera.inverse()).multiply(new DOMMatrix(object.matrixWorld.elements)).toFloat64Array());
};
