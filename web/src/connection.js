// A WebSocket to the server, opened again when it is lost.
const AGAIN_MS = 1000;
export const BUSY = 4001;

export class Connection {
  constructor(role, take) {
    this.role = role;
    this.take = take;
    this.closed = false;
    this.open();
  }

  open() {
    const address = new URL("/ws", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.searchParams.set("role", this.role);
    const token = new URLSearchParams(location.search).get("token");
    if (token) address.searchParams.set("token", token);
    this.socket = new WebSocket(address);
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
    // What the network does not take now would arrive too late to be of use.
    if (this.ready && this.socket.bufferedAmount < 65536) this.socket.send(JSON.stringify(message));
  }

  close() {
    this.closed = true;
    this.socket.close();
  }
}
