// What the headset reports in a frame: head, and grips or, without controllers, wrists.
const seven = ({ position: p, orientation: q }) => [p.x, p.y, p.z, q.x, q.y, q.z, q.w];

export function readFrame(time, frame, space) {
  const message = { type: "frame", t: time / 1000 };
  const viewer = frame.getViewerPose(space);
  if (viewer && !viewer.emulatedPosition) message.headset = seven(viewer.transform);
  for (const source of frame.session.inputSources) {
    if (source.handedness !== "left" && source.handedness !== "right") continue;
    // One that the cameras do not see is where the runtime's own sensors say.
    const pose = handPose(frame, source, space);
    if (pose) message[`${source.handedness}_controller`] = seven(pose.transform);
  }
  return message;
}

function handPose(frame, source, space) {
  if (source.hand) {
    const wrist = source.hand.get("wrist");
    return wrist && frame.getJointPose(wrist, space);
  }
  return source.gripSpace && frame.getPose(source.gripSpace, space);
}
