// Receivers: to whom embeddings are sealed, and the line that pairs one more.

import { get, remove, timed } from "./api.js";
import { button, card, columns, confirmed, empty, form, h, pick, say, secretLine } from "./dom.js";
import { RELEASES, ROLES, day, duration } from "./words.js";

// White modules around a QR code, as its standard asks for.
const MARGIN = 4;

function codeOf(rows) {
  const side = rows.length + 2 * MARGIN;
  const canvas = h("canvas", { width: side, height: side, class: "code", role: "img", "aria-label": "The same line as a QR code" });
  const context = canvas.getContext("2d");
  context.fillStyle = "#fff";
  context.fillRect(0, 0, side, side);
  context.fillStyle = "#000";
  rows.forEach((row, y) =>
    [...row].forEach((module, x) => module === "1" && context.fillRect(x + MARGIN, y + MARGIN, 1, 1)),
  );
  return canvas;
}

export function receiversView(camera) {
  const place = h("div", { class: "receivers" });
  const offered = h("section", { class: "card", "aria-label": "Line that pairs", tabindex: "-1", hidden: true });
  const left = h("p", { class: "note" });
  let ends = null;
  let known = new Set();
  let ticks = 0;

  async function load() {
    const { receivers } = await get("/v1/receivers");
    const made = receivers.find((each) => !known.has(each.id));
    if (ends !== null && made) close(`“${made.label}” is paired. Embeddings are sealed to it from the next mask on.`);
    known = new Set(receivers.map((each) => each.id));
    const text = "Nobody is paired: no embedding is sealed to anybody.";
    place.replaceChildren(receivers.length ? h("ul", { class: "findings" }, receivers.map(line)) : empty(text));
  }

  function line({ id, label, added_at: at }) {
    const drop = button("Remove", async () => {
      const question = `Remove the receiver “${label}”? Nothing more is sealed to it. What it has it can open.`;
      if (!(await confirmed(question, "Remove"))) return;
      await remove(`/v1/receivers/${id}`);
      await load();
    }, { plain: true, "aria-label": `Remove ${label}` });
    return h(
      "li",
      {},
      h("b", {}, label),
      h("span", { class: "note" }, "Fingerprint ", h("code", {}, id.match(/.{4}/g).slice(0, 8).join(" "))),
      h("span", { class: "note" }, `Paired ${day(at)}`),
      camera.may("admin:receivers") ? drop : null,
    );
  }

  // The line goes, and the height of its column stays, so that nothing moves.
  function close(text) {
    ends = null;
    const column = offered.parentElement;
    column.style.minHeight = `${column.offsetHeight}px`;
    if (offered.contains(document.activeElement)) offered.focus();
    offered.replaceChildren(h("p", { role: "status" }, text));
  }

  function tick() {
    if (ends === null) return;
    const seconds = (ends - performance.now()) / 1000;
    if (seconds <= 0) return close("The line has expired, and pairs nobody any more.");
    say(left, `It is valid once, for ${duration(seconds)} more.`);
    ticks += 1;
    if (ticks % 2 === 0) load().catch(() => {});
  }

  const pair = form(
    {},
    async (values) => {
      await load();
      // The clock of the camera may differ from that of this browser.
      const { answer, at } = await timed("/v1/pairing", { role: values.get("role") });
      const { elements, copy } = secretLine(answer.line, "On the receiver, type veilcam pair and then this line, between quotes:");
      offered.replaceChildren(h("h2", {}, "Line that pairs"), ...elements, h("p", { class: "row" }, copy), codeOf(answer.code), left);
      offered.hidden = false;
      offered.scrollIntoView({ block: "nearest" });
      ends = performance.now() + Date.parse(answer.expires_at) - at;
      tick();
    },
    pick("Role of its user", "role", "operator", Object.entries(ROLES).map(([role, text]) => [role, role, text])),
    h("button", { type: "submit" }, "Pair a receiver"),
  );
  load().catch((error) => place.replaceChildren(empty(error.message)));
  const release = h("p", { class: "note" });
  const list = card("Paired receivers", release, place);
  const pairs = camera.may("admin:receivers") && camera.may("admin:tokens");
  return {
    // What comes and goes is last, so that nothing moves for it.
    elements: [columns(pairs ? [card("Pair a receiver", pair)] : [], [list, offered])],
    update: () => say(release, RELEASES[camera.status.release]),
    tick,
    close: () => close(""),
  };
}
