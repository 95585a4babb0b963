// Augmented reality, where the browser and the device have it.

const AWAY = 0.8, BELOW = 0.1; // metres from the viewer's eyes to a single face

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

// Start or end a session; `room` is placed in front of the viewer, and brought back at the end. `overlay` is what a
// phone shows of the page in the session.
export async function toggle(renderer, scene, room, overlay) {
    const running = renderer.xr.getSession();
    if (running) return running.end();
    const session = await navigator.xr.requestSession("immersive-ar", {
        optionalFeatures: ["dom-overlay"],
        domOverlay: { root: overlay },
    });
    const background = scene.background, home = room.group.position.clone();
    renderer.xr.setReferenceSpaceType("local");
    scene.background = null;
    // The origin is where the viewer's eyes were at the start.
    if (room.height) room.group.position.set(0, -room.height, -1.3);
    else room.group.position.set(0, -BELOW, -AWAY);
    session.addEventListener("end", () => {
        scene.background = background;
        room.group.position.copy(home);
    });
    await renderer.xr.setSession(session);
    return session;
}
