// The connection: it comes back by itself, keeps the newest frame, and knows the server's clock.

const FRAME = 1, CLOCK = 2, HEADER = 16;
const ASK_EVERY = 1000, KEPT = 10; // milliseconds, answers
const PATIENCE = [250, 500, 1000, 2000]; // milliseconds before each attempt

export class Stream {
    constructor(address) {
        this.address = address;
        this.connected = false;
        this.scene = null; // { scene, path, images: how many each head has }
        this.frame = null; // newest, not taken yet
        this.bytes = this.received = 0;
        this._answers = [];
        this._attempt = 0;
        setInterval(() => this._ask(), ASK_EVERY);
        this._connect();
    }

    // The newest frame, once: { scene, taken, heads, view, offset }.
    take() {
        const frame = this.frame;
        this.frame = null;
        return frame;
    }

    // Milliseconds since a time of the server, or null while its clock is not known.
    since(taken) {
        if (!this._answers.length) return null;
        const best = this._answers.reduce((a, b) => (b.trip < a.trip ? b : a));
        return performance.now() + best.ahead - 1000 * taken;
    }

    _connect() {
        const socket = new WebSocket(this.address);
        socket.binaryType = "arraybuffer";
        socket.onopen = () => {
            this._open(socket);
            this._ask();
        };
        socket.onmessage = ({ data }) => this._receive(data);
        socket.onclose = () => {
            this.connected = false;
            this.scene = this.frame = null;
            setTimeout(() => this._connect(), PATIENCE[Math.min(this._attempt++, PATIENCE.length - 1)]);
        };
    }

    _open(socket) {
        this.connected = true;
        this._attempt = 0;
        this._answers = [];
        this.socket = socket;
    }

    _ask() {
        if (!this.connected || this.socket.readyState !== WebSocket.OPEN || document.hidden) return;
        this.socket.send(new Float64Array([performance.now()]));
    }

    _receive(data) {
        if (typeof data === "string") {
            this.scene = JSON.parse(data);
            this.frame = null;
            return;
        }
        const view = new DataView(data), now = performance.now();
        this.bytes += data.byteLength;
        if (view.getUint8(0) === CLOCK) {
            const sent = view.getFloat64(8, true), middle = (sent + now) / 2;
            this._answers.push({ trip: now - sent, ahead: 1000 * view.getFloat64(16, true) - middle });
            this._answers.splice(0, this._answers.length - KEPT);
        } else if (view.getUint8(0) === FRAME) {
            this.received++;
            this.frame = {
                heads: view.getUint8(1), scene: view.getUint16(2, true), number: view.getUint32(4, true),
                taken: view.getFloat64(8, true), view, offset: HEADER,
            };
        }
    }
}
