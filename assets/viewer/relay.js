// The connection to a relay, by NATS' text protocol over a WebSocket; what the heads look like is in static files.

import { Stream } from "./stream.js";

const END = [13, 10], MOST = 65536; // bytes of an incomplete operation
const AGAIN = 1000; // milliseconds until the same description may be loaded again

export class RelayStream extends Stream {
    constructor(address, password) {
        super(address);
        this.password = password;
    }

    _open(socket) {
        super._open(socket);
        this._rest = new Uint8Array(0);
        this._greeted = false;
        this._asked = null; // the scene whose description is on its way
    }

    _ask() {} // A relay does not know the sender's clock.

    _receive(data) {
        const bytes = new Uint8Array(this._rest.length + data.byteLength);
        bytes.set(this._rest);
        bytes.set(new Uint8Array(data), this._rest.length);
        let start = 0;
        for (let end; (end = lineEnd(bytes, start)) >= 0; ) {
            const words = String.fromCharCode(...bytes.subarray(start, end)).split(" ");
            const size = words[0] === "MSG" ? Number(words.at(-1)) : 0, from = end + END.length;
            if (words[0] === "MSG" && bytes.length < from + size + END.length) break;
            start = words[0] === "MSG" ? from + size + END.length : from;
            this._handle(words[0], bytes.slice(from, from + size));
        }
        this._rest = bytes.slice(start);
        if (this._rest.length > MOST) this.socket.close();
    }

    _handle(verb, payload) {
        if (verb === "INFO" && !this._greeted) {
            const options = { verbose: false, pedantic: false, user: "viewer", pass: this.password, lang: "js", version: "1", protocol: 1 };
            this.socket.send(`CONNECT ${JSON.stringify(options)}\r\nSUB facemime 1\r\n`);
            this._greeted = true;
        } else if (verb === "PING") this.socket.send("PONG\r\n");
        else if (verb === "-ERR") this.socket.close();
        else if (verb === "MSG") {
            super._receive(payload.buffer);
            if (this.frame && this.frame.scene !== (this.scene?.scene ?? null)) this._describe(this.frame.scene);
        }
    }

    // Load the description of a scene that is not known yet.
    async _describe(number) {
        if (this._asked === number) return;
        this._asked = number;
        setTimeout(() => (this._asked = null), AGAIN);
        const answer = await fetch("scene.json", { cache: "no-store" }).catch(() => null);
        const scene = answer?.ok ? await answer.json() : null;
        if (this.connected && scene && scene.scene !== this.scene?.scene) this.scene = scene;
    }
}

function lineEnd(bytes, start) {
    for (let at = bytes.indexOf(END[0], start); at >= 0; at = bytes.indexOf(END[0], at + 1))
        if (bytes[at + 1] === END[1]) return at;
    return -1;
}
