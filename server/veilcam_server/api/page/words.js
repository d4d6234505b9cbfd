// Words for people: of times, states, remedies, and threats.

export function duration(seconds) {
  if (seconds < 90) return `${Math.max(0, Math.round(seconds))} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} days`;
}

export const clock = (at) => new Date(at).toLocaleTimeString();
export const day = (at) => new Date(at).toLocaleString();

// How sure the camera is, as words; the least share that each stands for, the greatest first.
const SURE = [[0.95, "almost sure"], [0.8, "fairly sure"], [0.6, "not quite sure"], [0, "a guess"]];

export const sureText = (share) => (share === null ? "" : SURE.find(([least]) => share >= least)[1]);

export const STATES = {
  starting: "Starting",
  "self-test": "Testing the panel",
  ready: "Ready",
  calibrating: "Calibrating",
  degraded: "Degraded",
  safe: "Opaque, for safety",
  replay: "Replaying a recording",
  off: "Off, and opaque",
  stopping: "Stopping",
};

// States in which the panel is opaque: nothing is seen then.
const OPAQUE = new Set(["starting", "self-test", "off", "safe", "stopping"]);
const RESTING = new Set(["off", "quiet"]);

export function isOpaque({ status, watch }) {
  if (status.state === "replay") return false;
  return status.rotation.epoch === null || OPAQUE.has(status.state) || isResting(watch);
}

// Nothing is looked at, because that is wanted now.
export const isResting = (watch) => RESTING.has(watch?.activity);

const ACTIVITIES = {
  looking: (_, policy) => `It looks by itself, up to ${rateText(policy.rate_hz)}.`,
  on_request: () => "It looks when it is asked.",
  off: () => "It is off: the panel is opaque.",
  quiet: (_, policy) => `Quiet hours until ${policy.quiet.end}: the panel is opaque.`,
  leased: () => "It does not look: somebody else holds the camera.",
  waiting: (detail) => `It waits${detail ? `: ${detail}` : "."}`,
};

export const activityText = (activity, detail, policy) => (ACTIVITIES[activity] ?? ACTIVITIES.waiting)(detail, policy);

function rateText(rate) {
  if (rate >= 1) return rate === 1 ? "once a second" : `${rate} times a second`;
  return `once in ${duration(1 / rate)}`;
}

export const REMEDIES = {
  wait: "nothing: it is tried again",
  shield_light: "make the camera light tight around its panel, and put an infrared filter before it",
  adjust_light: "give the scene light that is steady, and not so bright that the sensor saturates",
  check_panel_wiring: "check power, wiring and tab of the panel",
  check_camera_cable: "check the cable of the camera",
  check_disk: "free space on the disk of the state directory, or replace it",
  run_doctor: "run veilcamd doctor: it names the package, group or device that is missing",
  install_bundle: "install a bundle that fits this camera and holds what is asked for",
  restart: "start the daemon again: a camera hangs in its driver; systemd does it by itself",
  report_defect: "report the defect that the log tells of: its kind and where it was raised",
};

export const THREATS = {
  T0: "sanity",
  T1: "ciphertext only",
  T2: "wrong key",
  T3: "pairs of other epochs",
  T4: "known pairs of this mask",
  T5: "leaked list",
  T6: "full leak",
  T7: "many shots",
  T8: "attributes and scores",
  T9: "linkage",
};

export const ROLES = {
  viewer: "Sees state, labels and this page, and may ask for a look.",
  operator: "Also changes masks, says when the camera looks, and takes captures for paired receivers.",
  owner: "May do everything: also receivers, tokens, bundles and calibration.",
};

export const SCOPES = {
  "read:status": "state, events, health",
  classify: "labels",
  "read:scores": "confidence, in tenths",
  "read:embedding": "embeddings, as they leave",
  "read:embedding:raw": "embeddings that leave raw",
  "read:log": "the log: what left, and who changed what",
  "mask:rotate": "changing masks, leases",
  calibrate: "calibrations",
  simulate: "the simulated scene and its faults",
  "admin:bundles": "bundles",
  "admin:receivers": "to whom embeddings are sealed",
  "admin:tokens": "making and revoking tokens",
  metrics: "metrics",
};

export const RELEASES = {
  none: "Embeddings stay in the camera: labels alone leave.",
  sealed: "Embeddings leave sealed: only paired receivers can open them.",
  raw: "Embeddings leave as they were read. Who knows the mask can compute a picture from them.",
};

export function next(rotation) {
  const { policy, epoch_age_s: age, captures } = rotation;
  if (rotation.epoch === null) return { text: "No mask is shown.", share: 0 };
  if (policy.mode === "off") return { text: "It stays until it is changed here.", share: 0 };
  if (policy.mode === "captures") {
    const left = policy.captures - captures;
    const share = Math.min(1, captures / policy.captures);
    if (left <= 0) return { text: "It changes with the next capture.", share: 1 };
    return { text: `It changes after ${left} more ${left === 1 ? "capture" : "captures"}.`, share };
  }
  const left = policy.seconds - age;
  if (left <= 0) return { text: "It changes as soon as the next one is ready.", share: 1 };
  const within = policy.jitter ? "within" : "in";
  return { text: `It changes ${within} ${duration(left)}.`, share: age / policy.seconds };
}

const EVENTS = {
  state: ({ state, detail }) => [STATES[state], detail].filter(Boolean).join(": "),
  mask: ({ epoch }) => `A new mask is shown, epoch ${epoch.slice(0, 8)}`,
  capture: () => "An embedding was taken",
  classification: ({ label }) => `It saw ${label}`,
  seen: ({ label }) => `It sees ${label}`,
  belief: ({ sighting }) => (sighting ? `It sees ${sighting.label}` : "It sees nothing"),
  gone: ({ label, duration_s: lasted }) => `${label} is gone, after ${duration(lasted)}`,
  watch: ({ activity, detail, policy }) => activityText(activity, detail, policy),
  rotation: ({ policy }) => `Masks change ${policyText(policy)}`,
  bundle: ({ task }) => `Another bundle is in use: ${task}`,
  calibration: ({ run }) => `Calibration: ${run.stage}`,
  fault: ({ detail, code }) => `${detail} (${code})`,
  gap: ({ missed }) => (missed === null ? "The daemon was restarted" : `${missed} events were missed`),
};

export const eventText = (event) => EVENTS[event.kind]?.(event) ?? event.kind;

export function policyText(policy) {
  if (policy.mode === "off") return "by hand alone";
  if (policy.mode === "seconds") return `every ${duration(policy.seconds)}`;
  return policy.captures === 1 ? "after every capture" : `after ${policy.captures} captures`;
}
