// Health: problems first, each with what helps; then all checks, what failed, and the camera itself.

import { get } from "./api.js";
import { button, card, columns, facts, fold, h, say } from "./dom.js";
import { REMEDIES, STATES, day, duration } from "./words.js";

const SIGNS = { ok: "well", bad: "to fix", skipped: "later" };
const FAILED = new Set(["degraded", "safe"]);

const finding = (name, texts, remedy, sign = null, outcome = null) =>
  h(
    "li",
    { "data-outcome": outcome },
    h("b", {}, name),
    sign && h("span", { class: "sign" }, sign),
    texts.filter(Boolean).map((text) => h("span", {}, text)),
    remedy ? h("span", { class: "remedy" }, `What helps: ${remedy}`) : null,
  );

const failure = (error) => h("li", { class: "empty" }, error.message);

export function healthView(camera) {
  const [problems, checks, faults, past] = ["", "polite", "", ""].map((live) =>
    h("ul", { class: "findings", "aria-live": live || null }),
  );
  const well = h("p", { class: "big", role: "status" });
  const about = h("div", {});
  const versions = h("div", {});
  let bad = [];
  let drawn = "";

  async function examine() {
    const { findings } = await get("/v1/doctor");
    bad = findings.filter((each) => each.outcome === "bad");
    const line = ({ name, outcome, found, remedy }) => finding(name, [found], remedy, SIGNS[outcome], outcome);
    checks.replaceChildren(...findings.filter((each) => !bad.includes(each)).map(line));
    draw();
  }

  async function load() {
    const found = await get("/v1/diagnostics");
    faults.replaceChildren(
      ...found.faults.toReversed().map((each) => finding(each.detail, [`${each.code}, ${day(each.at)}`], REMEDIES[each.remedy])),
    );
    if (!found.faults.length) faults.replaceChildren(h("li", { class: "empty" }, "Nothing failed since the start."));
    past.replaceChildren(...found.states.toReversed().map((each) => finding(STATES[each.state], [day(each.at), each.detail])));
    versions.replaceChildren(facts(Object.entries(found.versions)));
  }

  function draw() {
    const { status, watch } = camera;
    const now = [
      ...(FAILED.has(status.state) ? [finding(STATES[status.state], [status.detail], REMEDIES[status.remedy])] : []),
      ...bad.map(({ name, found, remedy }) => finding(name, [found], remedy, SIGNS.bad, "bad")),
    ];
    const text = now.map((each) => each.textContent).join("\n");
    if (text !== drawn) problems.replaceChildren(...now);
    drawn = text;
    const count = now.length === 1 ? "One problem" : `${now.length} problems`;
    say(well, now.length ? count : `${STATES[status.state]}: no problem was found`);
    about.replaceChildren(
      facts([
        ["Panel", status.device.display],
        ["Sensor", status.device.sensor],
        ["Device", status.device.simulated ? "simulated" : "real"],
        ["Running for", duration(status.uptime_s)],
        ["Captures since the start", String(status.captures + (watch?.looks ?? 0))],
        ["Waiting", `${status.queue.waiting} of ${status.queue.limit}`],
      ]),
    );
  }

  load().catch((error) => faults.replaceChildren(failure(error)));
  examine().catch((error) => checks.replaceChildren(failure(error)));

  return {
    elements: [
      columns(
        [card("Problems", well, problems), card("What failed since the start", faults)],
        [card("Checks", h("p", { class: "row" }, button("Check again", examine)), checks)],
        [card("This camera", about, fold("Versions", versions), fold("States before", past))],
      ),
    ],
    update(event) {
      draw();
      if (event?.kind === "fault" || event?.kind === "state" || event?.kind === "gap") load().catch(() => {});
    },
  };
}
