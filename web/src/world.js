// The room: floor, objects, mirror, arrows of forces, and a board with figures.
import {
  ArrowHelper, BoxGeometry, CanvasTexture, Color, DirectionalLight, Group, HemisphereLight, Mesh,
  MeshBasicMaterial, MeshStandardMaterial, NotEqualStencilFunc, PlaneGeometry, RepeatWrapping,
  ReplaceStencilOp, Scene, SphereGeometry, SRGBColorSpace, Vector3,
} from "three";
import { address } from "./address.js";
import { onlyInGlass } from "./figure.js";

const MIRROR_Z = -2;
const FLOOR_M = 30;
const N_TO_M = 0.0008;
const ASSIST_N_TO_M = 0.002;

export function makeWorld() {
  const scene = new Scene();
  scene.background = new Color(0xdfe6ee);
  scene.add(new HemisphereLight(0xffffff, 0x8a94a0, 1.7));
  const sun = new DirectionalLight(0xffffff, 1.6);
  sun.position.set(2, 5, 3);
  scene.add(sun, floor());
  return scene;
}

// Replaces the level floor by the session's terrain, if it has one; returns its heights or null.
// The mirror then shows a reflected terrain: the one behind it would hide the reflection's feet.
export async function loadGround(scene, mirror) {
  const ground = await (await fetch(address("/ground.json"))).json();
  if (!ground) return null;
  const level = scene.getObjectByName("floor");
  const shape = new PlaneGeometry(ground.side_m, ground.side_m, ground.points - 1, ground.points - 1);
  // A plane's rows run from far to near, each from left to right, as the server's do.
  ground.heights.forEach((height, i) => shape.attributes.position.setZ(i, height));
  shape.computeVertexNormals();
  level.geometry.dispose();
  level.geometry = shape;
  level.material.map.repeat.set(ground.side_m / 2, ground.side_m / 2);
  const reflected = new Mesh(shape, level.material.clone());
  reflected.rotation.copy(level.rotation);
  onlyInGlass(reflected);
  mirror.shifted.add(reflected);
  Object.assign(level.material, { stencilWrite: true, stencilRef: 1, stencilFunc: NotEqualStencilFunc });
  return ground;
}

// Height of the terrain at the point of its grid nearest to x and z; 0 without one.
export function heightAt(ground, x, z) {
  if (!ground) return 0;
  const spacing = ground.side_m / (ground.points - 1);
  const index = (along) => {
    const nearest = Math.round((along + ground.side_m / 2) / spacing);
    return Math.min(Math.max(nearest, 0), ground.points - 1);
  };
  return ground.heights[index(z) * ground.points + index(x)];
}

function floor() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 128;
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#c9d2dc";
  pen.fillRect(0, 0, 128, 128);
  pen.fillStyle = "#bac5d1";
  pen.fillRect(0, 0, 64, 64);
  pen.fillRect(64, 64, 64, 64);
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  texture.wrapS = texture.wrapT = RepeatWrapping;
  texture.repeat.set(FLOOR_M / 2, FLOOR_M / 2);
  texture.anisotropy = 4;
  const plane = new Mesh(new PlaneGeometry(FLOOR_M, FLOOR_M), new MeshStandardMaterial({ map: texture, roughness: 1 }));
  plane.rotation.x = -Math.PI / 2;
  plane.name = "floor";
  return plane;
}

// The session's objects, made of balls and boxes, posed by the server's messages.
export class WorldObjects extends Group {
  constructor(inMirror = false) {
    super();
    this.inMirror = inMirror;
  }

  build(objects) {
    this.clear();
    for (const parts of objects) {
      const object = new Group();
      for (const { shape, size, place } of parts) {
        const form = shape === "ball" ? new SphereGeometry(size[0], 24, 16) : new BoxGeometry(...size);
        const part = new Mesh(form, new MeshStandardMaterial({ color: 0xd9bf4d, roughness: 0.7 }));
        part.position.set(...place);
        object.add(part);
      }
      this.add(object);
    }
    if (this.inMirror) onlyInGlass(this);
  }

  show(poses) {
    this.children.forEach((object, i) => {
      object.visible = poses.length >= 7 * i + 7;
      if (!object.visible) return;
      object.position.fromArray(poses, 7 * i);
      object.quaternion.fromArray(poses, 7 * i + 3);
    });
  }
}

export async function loadObjects() {
  return (await fetch(address("/objects.json"))).json();
}

// The mirror shows a second, reflected figure. Rendering the room a second time would be too slow for
// headsets and wrong in one eye.
export class Mirror extends Group {
  constructor(...figures) {
    super();
    this.reflected = new Group();
    this.shifted = new Group();
    this.shifted.add(...figures);
    this.reflected.add(this.shifted);
    this.reflected.scale.z = -1;
    this.reflected.position.z = 2 * MIRROR_Z;
    const wood = new MeshStandardMaterial({ color: 0x6b7685, roughness: 0.6 });
    const bar = (w, h, x, y) => {
      const part = new Mesh(new BoxGeometry(w, h, 0.05), wood);
      part.position.set(x, y, MIRROR_Z);
      this.add(part);
    };
    bar(2.1, 0.05, 0, 2.25);
    bar(2.1, 0.05, 0, 0.025);
    bar(0.05, 2.25, -1.05, 1.125);
    bar(0.05, 2.25, 1.05, 1.125);
    const glass = new Mesh(
      new PlaneGeometry(2.05, 2.2),
      new MeshBasicMaterial({ color: 0xb8d4ee, transparent: true, opacity: 0.22, depthWrite: false }),
    );
    glass.position.set(0, 1.125, MIRROR_Z);
    // A mask is drawn first, so that the reflection is visible only in the glass, see onlyInGlass.
    const mask = new Mesh(glass.geometry, new MeshBasicMaterial({
      colorWrite: false, depthWrite: false, stencilWrite: true, stencilRef: 1, stencilZPass: ReplaceStencilOp,
    }));
    mask.position.copy(glass.position);
    mask.renderOrder = -2;
    this.add(this.reflected, mask, glass);
  }
}

// Mirror, board and the copy ahead stand before the user, and follow one who has walked further than this.
const LEASH_M = 1.0;
// The copy of the avatar that the user sees from behind, left of the mirror.
const AHEAD = new Vector3(-1.75, 0, -1.6);

export class Stage extends Group {
  constructor(mirror, board, ahead) {
    super();
    this.mirror = mirror;
    this.ahead = ahead;
    this.copy = new Group();
    this.copy.add(ahead);
    this.add(mirror, board, this.copy);
    this.ground = null;
    this.set(new Vector3(), 0);
  }

  // Stands on a terrain from now on; returns the change as a matrix.
  standOn(ground) {
    this.ground = ground;
    return this.set(this.position.clone(), this.rotation.y);
  }

  // Turns to a user at `place` who looks along `gaze`; returns the change as a matrix.
  face(place, gaze) {
    return this.set(place, gaze.lengthSq() > 0.01 ? Math.atan2(-gaze.x, -gaze.z) : this.rotation.y);
  }

  // Moves to a user who is too far away; returns the change as a matrix, or null.
  follow(place) {
    if (Math.hypot(place.x - this.position.x, place.z - this.position.z) < LEASH_M) return null;
    return this.set(place, this.rotation.y);
  }

  set(place, yaw) {
    this.updateMatrix();
    const change = this.matrix.clone().invert();
    // The mirror stands on the ground below its middle.
    const under = [place.x + MIRROR_Z * Math.sin(yaw), place.z + MIRROR_Z * Math.cos(yaw)];
    this.position.set(place.x, heightAt(this.ground, ...under), place.z);
    this.rotation.y = yaw;
    this.updateMatrix();
    // The figures' poses are in the world, not on the moved stage.
    const back = this.matrix.clone().invert();
    for (const group of [this.mirror.shifted, this.copy]) {
      back.decompose(group.position, group.quaternion, group.scale);
    }
    this.copy.position.add(AHEAD);
    return change.premultiply(this.matrix);
  }
}

export class Forces extends Group {
  constructor() {
    super();
    const arrow = (colour) => new ArrowHelper(new Vector3(0, 1, 0), new Vector3(), 0.1, colour, 0.06, 0.04);
    this.feet = [arrow(0x1ea05a), arrow(0x1ea05a)];
    this.assist = arrow(0xd07a10);
    // It begins inside the pelvis, which would hide it.
    for (const part of this.assist.children) Object.assign(part, { renderOrder: 1 }).material.depthTest = false;
    this.add(...this.feet, this.assist);
  }

  show(pose) {
    const at = (arrow, place, force, scale) => {
      const size = force.length();
      arrow.visible = size > 5;
      if (!arrow.visible) return;
      arrow.position.copy(place);
      arrow.setDirection(force.clone().divideScalar(size));
      arrow.setLength(Math.max(0.08, size * scale), 0.06, 0.04);
    };
    const vector = (list, i) => new Vector3().fromArray(list, 3 * i);
    [3, 6].forEach((link, i) => at(this.feet[i], vector(pose.p, link), vector(pose.force, i), N_TO_M));
    at(this.assist, vector(pose.p, 0), vector(pose.assist, 0), ASSIST_N_TO_M);
  }
}

// Text beside the mirror, for the wearer, who does not see the page.
export class Board extends Mesh {
  constructor() {
    const canvas = document.createElement("canvas");
    canvas.width = 1024;
    canvas.height = 512;
    const texture = new CanvasTexture(canvas);
    texture.colorSpace = SRGBColorSpace;
    super(new PlaneGeometry(1.2, 0.6), new MeshBasicMaterial({ map: texture }));
    this.pen = canvas.getContext("2d");
    this.position.set(1.85, 1.6, MIRROR_Z + 0.25);
    this.rotation.y = -0.45;
    this.shown = null;
  }

  show(lines) {
    const text = lines.join("\n");
    if (text === this.shown) return;
    this.shown = text;
    const { pen } = this;
    pen.fillStyle = "#1d2733";
    pen.fillRect(0, 0, 1024, 512);
    pen.fillStyle = "#ffffff";
    pen.font = "44px system-ui, sans-serif";
    wrapped(pen, lines, 960).slice(0, 8).forEach((line, i) => pen.fillText(line, 32, 72 + 58 * i));
    this.material.map.needsUpdate = true;
  }
}

function wrapped(pen, lines, width) {
  const out = [];
  for (const line of lines) {
    let row = "";
    for (const word of line.split(" ")) {
      if (row && pen.measureText(`${row} ${word}`).width > width) {
        out.push(row);
        row = word;
      } else row = row ? `${row} ${word}` : word;
    }
    out.push(row);
  }
  return out;
}
