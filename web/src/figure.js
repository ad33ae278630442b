// The avatar: sixteen meshes of the server's GLB, one for each link, posed by the server's messages.
import { EqualStencilFunc, Group, Quaternion, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { address } from "./address.js";

const LINKS = [
  "pelvis", "left_thigh", "left_shin", "left_foot", "right_thigh", "right_shin", "right_foot",
  "spine", "chest", "head", "left_upper_arm", "left_forearm", "left_hand",
  "right_upper_arm", "right_forearm", "right_hand",
];
// The avatar faces +z in the file, -z in WebXR.
const HALF_TURN = new Quaternion(0, 1, 0, 0);

// Lets a group be drawn only where the mirror's mask is, see Mirror.
export function onlyInGlass(group) {
  group.traverse((node) => {
    if (!node.isMesh) return;
    node.renderOrder = -1;
    Object.assign(node.material, { stencilWrite: true, stencilRef: 1, stencilFunc: EqualStencilFunc });
  });
}

// Where an orientation looks, level.
export function gazeOf(quaternion) {
  return new Vector3(0, 0, -1).applyQuaternion(quaternion).setY(0);
}

export class Figure extends Group {
  constructor(inMirror = false) {
    super();
    this.inMirror = inMirror;
    this.links = [];
    this.headless = false;
    this.place = new Vector3();
    this.gaze = new Vector3(0, 0, -1);
    this.hide();
  }

  // Children, so that whoever has the figure decides whether it is visible at all.
  hide() {
    for (const link of this.links) link.visible = false;
  }

  async load(height) {
    const file = await new GLTFLoader().loadAsync(address("/avatar.glb", { height }).href);
    const found = LINKS.map((name) => file.scene.getObjectByName(name));
    // Messages have the pose of every link in the world, so no link is the child of another.
    for (const link of found) link.removeFromParent();
    this.clear();
    this.add(...found);
    this.links = found;
    this.hide();
    if (this.inMirror) onlyInGlass(this);
  }

  show(pose) {
    this.links.forEach((link, i) => {
      link.position.fromArray(pose.p, 3 * i);
      // The server sends xyzw, as WebXR and three.js have it.
      link.quaternion.fromArray(pose.q, 4 * i).multiply(HALF_TURN);
      // The wearer's camera is inside the head, which would hide everything else.
      link.visible = !(this.headless && LINKS[i] === "head");
    });
    this.place.fromArray(pose.p);
    this.gaze = gazeOf(new Quaternion().fromArray(pose.q, 4 * LINKS.indexOf("head")));
  }
}
