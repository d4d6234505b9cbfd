// Log: what left this camera, and who changed it, the latest first.

import { get } from "./api.js";
import { button, card, h } from "./dom.js";
import { day } from "./words.js";

const SHOWN = 100;
const HASHES = new Set(["mask", "calibration", "answer"]);

export function logView() {
  const list = h("ul", { class: "findings", "aria-live": "polite" });

  async function load() {
    const { records } = await get(`/v1/log?newest=true&limit=${SHOWN}`);
    list.replaceChildren(...records.toReversed().map(line));
  }

  function line({ position, kind, at, facts }) {
    const told = Object.entries(facts).filter(([name]) => !HASHES.has(name));
    return h(
      "li",
      {},
      h("b", {}, `${kind} ${position}`),
      h("span", {}, day(at)),
      h("span", {}, told.map(([name, value]) => `${name} ${value}`).join(", ")),
    );
  }

  const failed = (error) => list.replaceChildren(h("li", { class: "empty" }, error.message));
  load().catch(failed);
  const note = `The last ${SHOWN} records. “veilcam log FILE” fetches all of them, and “veilcam verify FILE” checks them.`;
  const shown = card(
    "What left this camera, and who changed it",
    h("p", { class: "note" }, note),
    h("p", { class: "row" }, button("Load again", load)),
    list,
  );
  shown.classList.add("wide");
  return { elements: [shown], update() {} };
}
