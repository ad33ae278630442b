// The poses that a headset reports in a frame: head and controllers, or tracked hands.
import { Quaternion, Vector3 } from "three";

const seven = ({ position: p, orientation: q }) => [p.x, p.y, p.z, q.x, q.y, q.z, q.w];

// From a wrist (-z towards the fingers, y out of the back of the hand) to the pose that a controller
// in the fist would report (-z towards the thumb, y towards the elbow).
const FIST = new Vector3(0, 0, -0.08);
const FIST_TURN = {
  left: new Quaternion(0.5, -0.5, -0.5, 0.5),
  right: new Quaternion(0.5, 0.5, 0.5, 0.5),
};

export function readFrame(time, frame, space) {
  const message = { type: "frame", t: time / 1000 };
  const viewer = frame.getViewerPose(space);
  if (viewer && !viewer.emulatedPosition) message.headset = seven(viewer.transform);
  for (const source of frame.session.inputSources) {
    const side = source.handedness;
    if (side !== "left" && side !== "right") continue;
    // Of a controller that the cameras do not see, the runtime estimates the pose.
    const pose = source.hand ? fist(frame, source, space)
      : source.gripSpace && frame.getPose(source.gripSpace, space)?.transform;
    if (pose) message[`${side}_controller`] = seven(pose);
  }
  return message;
}

function fist(frame, source, space) {
  const joint = source.hand.get("wrist");
  const wrist = joint && frame.getJointPose(joint, space)?.transform;
  if (!wrist) return null;
  const { x, y, z, w } = wrist.orientation;
  const turn = new Quaternion(x, y, z, w);
  const position = FIST.clone().applyQuaternion(turn).add(wrist.position);
  return { position, orientation: turn.multiply(FIST_TURN[source.handedness]) };
}
