// A button that is held on both controllers at once, or a pinch of both hands.
const HOLD_MS = 2000;

export class HeldTogether {
  constructor(session, name, act) {
    this.act = act;
    this.sides = new Set();
    this.since = null;
    session.addEventListener(`${name}start`, (event) => this.sides.add(event.inputSource.handedness));
    session.addEventListener(`${name}end`, (event) => this.sides.delete(event.inputSource.handedness));
  }

  // Acts once if both have been held for long enough at `time` (ms).
  look(time) {
    if (this.sides.size < 2) this.since = null;
    else if (this.since === null) this.since = time;
    else if (time - this.since >= HOLD_MS) {
      this.since = Infinity;
      this.act();
    }
  }
}
