// The avatar: sixteen meshes of the server's GLB, each put where a message says.
import { EqualStencilFunc, Group, Quaternion } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const LINKS = [
  "pelvis", "left_thigh", "left_shin", "left_foot", "right_thigh", "right_shin", "right_foot",
  "spine", "chest", "head", "left_upper_arm", "left_forearm", "left_hand",
  "right_upper_arm", "right_forearm", "right_hand",
];
// The file faces +z, WebXR -z.
const HALF_TURN = new Quaternion(0, 1, 0, 0);

// Draws a reflection only where the mirror's mask is, see Mirror.
export function onlyInGlass(group) {
  group.traverse((node) => {
    if (!node.isMesh) return;
    node.renderOrder = -1;
    Object.assign(node.material, { stencilWrite: true, stencilRef: 1, stencilFunc: EqualStencilFunc });
  });
}

export class Figure extends Group {
  constructor(inMirror = false) {
    super();
    this.inMirror = inMirror;
    this.links = [];
    this.visible = false;
  }

  async load(height) {
    const address = new URL("/avatar.glb", location.href);
    address.searchParams.set("height", height);
    const token = new URLSearchParams(location.search).get("token");
    if (token) address.searchParams.set("token", token);
    const file = await new GLTFLoader().loadAsync(address.href);
    const found = LINKS.map((name) => file.scene.getObjectByName(name));
    // Every link has a pose in the world: none hangs on another.
    for (const link of found) link.removeFromParent();
    this.clear();
    this.add(...found);
    this.links = found;
    if (this.inMirror) onlyInGlass(this);
  }

  show(pose) {
    this.links.forEach((link, i) => {
      link.position.fromArray(pose.p, 3 * i);
      // wxyz or xyzw: the server sends WebXR's xyzw.
      link.quaternion.fromArray(pose.q, 4 * i).multiply(HALF_TURN);
    });
    this.visible = this.links.length > 0;
  }

  // The wearer looks out of the head: it would be all that they see.
  set headless(on) {
    const head = this.links[LINKS.indexOf("head")];
    if (head) head.visible = !on;
  }
}
