// Health: the state, what the doctor finds, and what failed lately, each with what helps.

import { get } from "./api.js";
import { button, card, columns, h, say } from "./dom.js";
import { REMEDIES, STATES, day, duration } from "./words.js";

const SIGNS = { ok: "well", bad: "to fix", skipped: "later" };

export function healthView(camera) {
  const state = h("p", { class: "big" });
  const detail = h("p", {});
  const remedy = h("p", { class: "remedy" });
  const facts = h("dl", { class: "facts" });
  const findings = h("ul", { class: "findings", "aria-live": "polite" });
  const faults = h("ul", { class: "findings" });
  const past = h("ul", { class: "findings" });
  const versions = h("dl", { class: "facts" });

  async function examine() {
    const { findings: found } = await get("/v1/doctor");
    const order = ["bad", "skipped", "ok"];
    found.sort((a, b) => order.indexOf(a.outcome) - order.indexOf(b.outcome));
    findings.replaceChildren(
      ...found.map(({ name, outcome, found: what, remedy: helps }) =>
        h(
          "li",
          { "data-outcome": outcome },
          h("b", {}, name),
          h("span", { class: "sign" }, SIGNS[outcome]),
          h("span", {}, what),
          helps ? h("span", { class: "remedy" }, `What helps: ${helps}`) : null,
        ),
      ),
    );
  }

  async function load() {
    const found = await get("/v1/diagnostics");
    faults.replaceChildren(
      ...found.faults.toReversed().map((each) =>
        h(
          "li",
          {},
          h("b", {}, each.detail),
          h("span", {}, `${each.code}, ${day(each.at)}`),
          h("span", { class: "remedy" }, `What helps: ${REMEDIES[each.remedy]}`),
        ),
      ),
    );
    if (!found.faults.length) faults.replaceChildren(h("li", { class: "empty" }, "Nothing failed since the start."));
    past.replaceChildren(
      ...found.states.toReversed().map((each) =>
        h("li", {}, h("b", {}, STATES[each.state]), h("span", {}, day(each.at)), each.detail ? h("span", {}, each.detail) : null),
      ),
    );
    define(versions, Object.entries(found.versions));
  }

  function define(list, pairs) {
    list.replaceChildren(
      ...pairs.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))),
    );
  }

  function draw() {
    const { status } = camera;
    say(state, STATES[status.state]);
    say(detail, status.detail ?? "");
    say(remedy, status.remedy ? `What helps: ${REMEDIES[status.remedy]}` : "");
    define(facts, [
      ["Panel", status.device.display],
      ["Sensor", status.device.sensor],
      ["Device", status.device.simulated ? "simulated" : "real"],
      ["Running for", duration(status.uptime_s)],
      ["Captures since the start", String(status.captures)],
      ["Waiting", `${status.queue.waiting} of ${status.queue.limit}`],
    ]);
  }

  load().catch((error) => faults.replaceChildren(h("li", { class: "empty" }, error.message)));
  const again = button("Examine again", examine);
  examine().catch((error) => findings.replaceChildren(h("li", { class: "empty" }, error.message)));

  return {
    elements: [
      columns(
        [card("State", state, detail, remedy, facts), card("Versions", versions)],
        [card("Doctor", findings, h("p", { class: "row" }, again))],
        [card("What failed", faults), card("States before", past)],
      ),
    ],
    update(event) {
      draw();
      if (event?.kind === "fault" || event?.kind === "state" || event?.kind === "gap") load().catch(() => {});
    },
  };
}
