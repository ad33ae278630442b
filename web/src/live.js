// The page of `questsim live`: the user who enters VR drives the avatar, all others watch.
import { PerspectiveCamera, Quaternion, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { VRButton } from "three/addons/webxr/VRButton.js";
import { Connection } from "./connection.js";
import { readFrame } from "./devices.js";
import { Figure, gazeOf } from "./figure.js";
import { HeldTogether } from "./held.js";
import { numbersOf } from "./numbers.js";
import { Board, Forces, Mirror, Stage, WorldObjects, loadGround, loadObjects, makeWorld } from "./world.js";

const element = (id) => document.getElementById(id);
const EVENT_MS = 4000;

const renderer = new WebGLRenderer({ antialias: true, stencil: true });
renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
renderer.setSize(innerWidth, innerHeight);
renderer.xr.enabled = true;
renderer.xr.setReferenceSpaceType("local-floor");
const features = { optionalFeatures: ["hand-tracking"] };
document.body.append(renderer.domElement);
// Without a headset there is nothing to press: such a page watches.
navigator.xr?.isSessionSupported("immersive-vr").then((can) => {
  if (can) document.body.append(VRButton.createButton(renderer, features));
});

const camera = new PerspectiveCamera(50, innerWidth / innerHeight, 0.05, 100);
camera.position.set(1.5, 1.7, 2.1);
const orbit = new OrbitControls(camera, renderer.domElement);
orbit.target.set(0.2, 1.05, -1.2);
orbit.update();
addEventListener("resize", () => {
  camera.aspect = innerWidth / innerHeight;
  camera.updateProjectionMatrix();
  renderer.setSize(innerWidth, innerHeight);
});

const scene = makeWorld();
const own = new Figure();
const mirrored = new Figure(true);
const ahead = new Figure();
const forces = new Forces();
forces.visible = false;
const board = new Board();
const objects = new WorldObjects();
const mirroredObjects = new WorldObjects(true);
const mirror = new Mirror(mirrored, mirroredObjects);
const stage = new Stage(mirror, board, ahead);
scene.add(own, objects, stage, forces);
loadGround(scene, mirror).then((ground) => {
  ahead.visible = !ground; // on a terrain its place has another height
  seen(stage.standOn(ground));
}).catch((error) => {
  element("fault").textContent = `the ground was not loaded: ${error.message}`;
});

const state = { text: "connecting", numbers: "", event: "", eventAt: 0, height: null };
let connection = new Connection("watcher", take);
let session = null;
let drives = false;
let held = [];
// Whether mirror and board stand before the wearer, and before the avatar.
let wearerFaced = false;
let avatarFaced = false;

function take(message) {
  if (message.type === "pose") showPose(message);
  else if (message.type === "state") showState(message);
  else if (message.type === "refused") element("fault").textContent = message.text;
  else if (message.type === "busy") {
    element("fault").textContent = message.text;
    drives = false;
    connection = new Connection("watcher", take);
  } else if (message.type === "lost") state.text = "the connection is lost; trying again";
  else if (message.type === "failure") state.text = "the simulation failed; see the server's terminal";
  showText();
}

function showState(message) {
  state.text = message.text || (message.state === "following" ? "following" : message.state);
  // Only the driver may switch the assist.
  element("assist").disabled = !drives || message.assist_n === 0;
  element("assist").checked = message.assist_on;
  if (message.state !== "following") {
    for (const figure of [own, mirrored, ahead]) figure.hide();
    forces.visible = false;
    avatarFaced = false;
    state.numbers = "";
  }
  if (message.height_m && message.height_m !== state.height) {
    state.height = message.height_m;
    loadObjects().then((parts) => {
      for (const group of [objects, mirroredObjects]) group.build(parts);
    }).catch((error) => {
      element("fault").textContent = `the objects were not loaded: ${error.message}`;
    });
    for (const figure of [own, mirrored, ahead]) figure.load(message.height_m).catch((error) => {
      element("fault").textContent = `the avatar was not loaded: ${error.message}`;
    });
  }
}

function showPose(pose) {
  own.headless = session !== null;
  for (const figure of [own, mirrored, ahead]) figure.show(pose);
  objects.show(pose.objects);
  mirroredObjects.show(pose.objects);
  if (!avatarFaced) seen(stage.face(own.place, own.gaze));
  else seen(stage.follow(own.place));
  avatarFaced = true;
  forces.visible = true;
  forces.show(pose);
  state.numbers = numbersOf(pose).join("\n");
  window.lastPose = pose; // read by tests
  if (pose.events.length) {
    state.event = pose.events.join("; ");
    state.eventAt = performance.now();
  }
}

// The watcher's view goes along with the stage.
function seen(change) {
  if (!change) return;
  camera.position.applyMatrix4(change);
  orbit.target.applyMatrix4(change);
  orbit.update();
}

// For the wearer, who does not see the page's buttons.
function help() {
  const assist = element("assist").disabled ? [] : ["both grips for 2 s: assist on or off"];
  return ["", "both triggers for 2 s: measure again", ...assist];
}

function showText() {
  const event = performance.now() - state.eventAt < EVENT_MS ? state.event : "";
  element("text").textContent = event || state.text;
  element("numbers").textContent = state.numbers;
  board.show([event || state.text, ...state.numbers.split("\n"), ...(session ? help() : [])]);
}

renderer.xr.addEventListener("sessionstart", () => {
  session = renderer.xr.getSession();
  wearerFaced = false;
  // The wearer does not see the page's buttons.
  held = [
    new HeldTogether(session, "select", measureAgain),
    new HeldTogether(session, "squeeze", () => {
      const box = element("assist");
      if (!box.disabled) switchAssist(!box.checked);
    }),
  ];
  // Quest's browser closes sockets that were opened before, so the driver opens a new one.
  connection.close();
  drives = true;
  connection = new Connection("driver", take);
  element("calibrate").hidden = false;
});
renderer.xr.addEventListener("sessionend", () => {
  session = null;
  drives = false;
  element("calibrate").hidden = true;
  connection.close();
  connection = new Connection("watcher", take);
});
function measureAgain() {
  connection.send({ type: "calibrate" });
}
function switchAssist(on) {
  connection.send({ type: "assist", on });
}
element("calibrate").onclick = measureAgain;
element("assist").onchange = (event) => switchAssist(event.target.checked);

renderer.setAnimationLoop((time, frame) => {
  if (frame && drives) {
    const space = renderer.xr.getReferenceSpace();
    if (space) {
      connection.send(readFrame(frame.predictedDisplayTime ?? time, frame, space));
      const viewer = frame.getViewerPose(space);
      if (viewer && !wearerFaced) {
        const { position: p, orientation: q } = viewer.transform;
        seen(stage.face(new Vector3(p.x, p.y, p.z), gazeOf(new Quaternion(q.x, q.y, q.z, q.w))));
        wearerFaced = true;
      }
    }
    for (const one of held) one.look(time);
  }
  renderer.render(scene, camera);
});
