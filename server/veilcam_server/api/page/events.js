// Events: what happened since the page was opened, the latest first.

import { card, empty, h } from "./dom.js";
import { clock, eventText } from "./words.js";

export const OFTEN = new Set(["mask", "capture", "belief"]);

export function eventsView(camera) {
  const list = h("ol", { class: "events", tabindex: "0", "aria-label": "Events" });
  const none = empty("Nothing happened since this page was opened.");
  const all = h("input", { type: "checkbox" });
  all.addEventListener("change", draw);

  const line = (event) =>
    h(
      "li",
      {},
      h("time", { datetime: event.at }, clock(event.at)),
      h("span", { class: "kind" }, event.kind),
      h("span", {}, eventText(event)),
    );

  function draw() {
    const wanted = camera.events.filter((event) => all.checked || !OFTEN.has(event.kind));
    list.replaceChildren(...wanted.map(line));
    none.hidden = wanted.length > 0;
    list.hidden = !none.hidden;
  }

  const choice = h("label", { class: "check" }, all, h("span", {}, "Masks and captures, too"));
  const shown = card("What happened", choice, none, list);
  shown.classList.add("wide");
  return {
    elements: [shown],
    update(event) {
      if (!event || all.checked || !OFTEN.has(event.kind)) draw();
    },
  };
}
