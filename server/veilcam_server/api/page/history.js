// History: what this page has heard, in its own memory alone. Labels of the last hour, and looks of
// the last minute.

import { card, empty, fold, h } from "./dom.js";
import { clock, duration, sureText } from "./words.js";

const HOUR = 3_600_000;
const MINUTE = 60_000;
// Least time that a rate is computed from [ms].
const LEAST = 5000;
const LISTED = 12;

export function createMemory() {
  let open = false;
  let counts = [];
  const memory = {
    heard: [],
    lookedAt: null,
    // The label that the camera believes in now; null: none.
    note(label, at = Date.now(), until = at) {
      const last = memory.heard.at(-1);
      if (open && last.label === label) last.to = until;
      else if (label !== null) memory.heard.push({ label, from: at, to: until });
      open = label !== null;
      memory.heard = memory.heard.filter(({ to }) => to > at - HOUR);
    },
    // No answer comes: what was seen may have gone since.
    pause: () => (open = false),
    looked: () => (memory.lookedAt = performance.now()),
    // Looks of the watch since the start of the daemon.
    count(looks) {
      const at = performance.now();
      const before = counts.at(-1)?.looks ?? looks;
      if (looks > before) memory.looked();
      if (looks < before) counts = [];
      counts = [...counts.filter((each) => each.at > at - MINUTE), { at, looks }];
    },
    // Looks a second over the last minute; null: not known yet.
    rate() {
      const [first, last] = [counts[0], counts.at(-1)];
      if (!first || last.at - first.at < LEAST) return null;
      return (1000 * (last.looks - first.looks)) / (last.at - first.at);
    },
  };
  return memory;
}

export function historyCard(camera) {
  const strip = h("ol", { class: "strip", "aria-label": "Labels of the last hour" });
  const none = empty("This page has heard of no label yet.");
  const axis = h("p", { class: "note axis" }, h("span", {}, "an hour ago"), h("span", {}, "now"));
  const list = h("ol", { class: "history", "aria-label": "One by one" });
  let [drawn, count, listed] = [0, 0, ""];

  function row(label, now) {
    const spans = camera.memory.heard.filter((each) => each.label === label);
    const lasted = spans.reduce((sum, { from, to }) => sum + to - from, 0);
    const track = spans.map(({ from, to }) => {
      const span = h("span", {});
      span.style.left = `${Math.max(0, 100 - (100 * (now - from)) / HOUR)}%`;
      span.style.width = `${(100 * (to - from)) / HOUR}%`;
      return span;
    });
    return h("li", {}, h("b", {}, label), h("span", { class: "track", "aria-hidden": "true" }, track), h("span", {}, duration(lasted / 1000)));
  }

  function draw() {
    const now = Date.now();
    [drawn, count] = [now, camera.memory.heard.length];
    const labels = [...new Set(camera.memory.heard.map(({ label }) => label))].sort();
    strip.replaceChildren(...labels.map((label) => row(label, now)));
    none.hidden = labels.length > 0;
    axis.hidden = !none.hidden;
  }

  // Anew only where it differs, so that nothing that is read or marked is lost.
  function update() {
    const items = (camera.watch?.history ?? []).slice(0, LISTED).map(sighting);
    const text = items.map((item) => item.textContent).join("\n");
    if (text !== listed) list.replaceChildren(...items);
    listed = text;
    tick();
  }

  function tick() {
    if (camera.memory.heard.length !== count || Date.now() - drawn > LEAST) draw();
  }

  draw();
  const note = "The last hour, as this page heard it. It is kept nowhere else.";
  return {
    element: card("History", h("p", { class: "note" }, note), none, strip, axis, fold("One by one", list)),
    update,
    tick,
  };
}

function sighting({ label, confidence, seen_at: at, duration_s: lasted, gone_at: gone }) {
  const long = gone === null ? "still there" : `for ${duration(lasted)}`;
  return h("li", {}, h("b", {}, label), ` ${[clock(at), long, sureText(confidence)].filter(Boolean).join(", ")}`);
}
