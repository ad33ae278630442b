// What the page and its board say about a pose.
export function numbersOf(pose) {
  return [
    `device error ${pose.error_cm === null ? "-" : pose.error_cm.toFixed(1)} cm`,
    `server time ${pose.step_ms.toFixed(1)} ms`,
    `assist ${Math.hypot(...pose.assist).toFixed(0)} N`,
    // A device that does not report, by its name.
    ...pose.silent.map((name) => `no signal: ${name.replaceAll("_", " ")}`),
  ];
}
