// A WebSocket to the server, opened again when it is lost.
import { address } from "./address.js";

const AGAIN_MS = 1000;
export const BUSY = 4001;

// By this the server knows a driver whose connection was lost: it goes on without a new calibration.
const newId = () => Array.from(crypto.getRandomValues(new Uint8Array(12)), (b) => b.toString(36)).join("");

export class Connection {
  constructor(role, take) {
    this.role = role;
    this.id = newId();
    this.take = take;
    this.closed = false;
    this.open();
  }

  open() {
    const url = address("/ws", { role: this.role, id: this.id });
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(url);
    this.socket.onmessage = (event) => this.take(JSON.parse(event.data));
    this.socket.onclose = (event) => {
      if (this.closed) return;
      if (event.code === BUSY) return this.take({ type: "busy", text: event.reason });
      this.take({ type: "lost" });
      setTimeout(() => this.closed || this.open(), AGAIN_MS);
    };
  }

  get ready() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  send(message) {
    // A message that waits for a slow network would arrive too late to be of use.
    if (this.ready && this.socket.bufferedAmount < 65536) this.socket.send(JSON.stringify(message));
  }

  close() {
    this.closed = true;
    this.socket.close();
  }
}
