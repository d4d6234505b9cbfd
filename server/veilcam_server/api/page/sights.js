// Sights: what came and went, from one state of the camera to the next.

// The events between the newest sight that is known and the next state.
export function changes(newest, { at, belief, sighting }) {
  const before = newest && newest.gone_at === null ? newest : null;
  const stays =
    before && sighting && before.label === sighting.label && before.duration_s <= sighting.duration_s;
  if (stays || (!before && !sighting)) return [];
  const events = [];
  if (before) {
    const reason = belief === null ? "not_looking" : "left";
    const lasted = (new Date(at) - new Date(before.seen_at)) / 1000;
    events.push({ kind: "gone", at, label: before.label, duration_s: lasted, reason });
  }
  if (sighting) events.push({ kind: "seen", at, ...sighting });
  return events;
}

// A watch after something came or went.
export function withChange(watch, event) {
  if (!watch || (event.kind !== "seen" && event.kind !== "gone")) return watch;
  const { at, label, confidence = null, duration_s: lasted } = event;
  const since = new Date(new Date(at) - 1000 * lasted).toISOString();
  const [newest, ...rest] = watch.history;
  if (event.kind === "gone") {
    const belief = event.reason === "left" ? { label: null, confidence: null, since: at } : null;
    if (!newest || newest.gone_at !== null) return { ...watch, belief };
    return { ...watch, belief, history: [{ ...newest, gone_at: at, duration_s: lasted }, ...rest] };
  }
  const sight = { label, confidence, seen_at: since, gone_at: null, duration_s: lasted };
  return { ...watch, belief: { label, confidence, since }, history: [sight, ...watch.history] };
}
