// Calibration as a wizard: three scenes, each set by a person, and what was found.

import { get, post, remove } from "./api.js";
import { button, card, columns, confirmed, empty, facts, field, fold, form, h, say } from "./dom.js";
import { day, duration } from "./words.js";

const SCENES = {
  dark: "the camera is covered, so that no light gets in.",
  "white card": "a white card, evenly lit, fills what the camera sees.",
  lamp: "a lamp behind a small hole in black card, and no other light.",
};
const NAMES = Object.keys(SCENES);
const upper = (name) => name[0].toUpperCase() + name.slice(1);
const ENDED = new Set(["done", "failed", "cancelled"]);
const SAID = {
  done: "The camera is calibrated. What was found is used from now on, and after a restart.",
  failed: "The calibration failed, and nothing was changed.",
  cancelled: "The calibration was ended, and nothing was changed.",
};

export function calibrationView(camera) {
  const place = h("div", {});
  const record = h("div", {});
  const paced = { before: null, exposures: 0, spent: 0 };
  let stage = null;

  // Time that exposures still take, by those so far; setting the scenes is not counted.
  function left(run) {
    const [at, { before }] = [performance.now(), paced];
    if (before && before.stage === "measuring" && run.exposures > before.exposures) {
      paced.exposures += run.exposures - before.exposures;
      paced.spent += at - before.at;
    }
    if (!before || before.stage !== run.stage || before.exposures !== run.exposures) paced.before = { ...run, at };
    const taken = `${run.exposures} of ${run.total} exposures`;
    if (!paced.exposures) return taken;
    const seconds = ((run.total - run.exposures) * paced.spent) / paced.exposures / 1000;
    return `${taken}, about ${duration(seconds)} left`;
  }

  function begin(told) {
    const { simulated } = camera.status.device;
    const repeats = h("input", {
      name: "repeats", type: "number", min: "1", max: "100", required: true, value: "2",
    });
    return card(
      "Measure the camera",
      told,
      h("p", {}, "This is the first job of a real camera: without it, the camera is taken to be as it was drawn. It is measured before three scenes, and takes no captures meanwhile."),
      h("ol", { class: "scenes" }, NAMES.map((name) => h("li", {}, h("b", {}, upper(name)), `: ${SCENES[name]}`))),
      h("p", { class: "note" }, simulated
        ? "This camera is simulated, and sets the scenes by itself."
        : "Have card and lamp at hand. Sizes and distances are told when a scene is due; it waits for you up to 10 minutes."),
      form(
        {},
        async (values) => {
          Object.assign(paced, { before: null, exposures: 0, spent: 0 });
          draw(await post("/v1/calibration", { repeats: Number(values.get("repeats")) }));
        },
        fold("How exact", field("Exposures for one measurement", repeats, "More take longer, and are more exact.")),
        h("button", { type: "submit" }, "Begin"),
      ),
    );
  }

  function steps(run) {
    const present = NAMES.indexOf(run.scene);
    const bar = h("progress", {
      max: String(run.total), value: String(run.exposures), "aria-label": "Exposures taken",
    });
    const doing = {
      waiting: run.instruction ?? "",
      measuring: "Measuring. Leave the scene as it is.",
      fitting: "All is measured. The camera is computed from it; that takes a while.",
    }[run.stage];
    return card(
      "Measure the camera",
      h(
        "ol",
        { class: "steps" },
        NAMES.map((name, index) => {
          const done = run.stage === "fitting" || index < present;
          return h(
            "li",
            { "aria-current": index === present ? "step" : null, class: done ? "done" : null },
            upper(name),
            done ? h("span", { class: "hidden" }, ", done") : null,
          );
        }),
      ),
      h("p", { class: "instruction", role: "status" }, doing),
      bar,
      h("p", { class: "note" }, left(run)),
      h(
        "p",
        { class: "row" },
        run.stage === "waiting"
          ? button("Scene is set", async () => {
              draw(await post("/v1/calibration/scene", { scene: run.scene }));
            })
          : null,
        button("End it", async () => {
          if (await confirmed("End the calibration? Nothing will be changed.", "End it")) {
            draw(await remove("/v1/calibration"));
          }
        }, { plain: true }),
      ),
    );
  }

  // What only counts is changed in its place, so that no focus and no dialog is lost.
  function count(run) {
    const bar = place.querySelector("progress");
    if (!bar) return;
    bar.value = run.exposures;
    say(place.querySelector(".note"), left(run));
  }

  function draw(run) {
    const now = run === null ? "none" : `${run.stage} ${run.scene}`;
    if (now === stage) return run === null ? undefined : count(run);
    stage = now;
    if (run !== null && !ENDED.has(run.stage)) {
      place.replaceChildren(steps(run));
    } else {
      const told = run && h("p", { role: "status" }, `${SAID[run.stage]} ${run.detail ?? ""}`);
      place.replaceChildren(begin(told));
    }
    if (run === null || ENDED.has(run.stage)) load().catch(() => {});
    return undefined;
  }

  function show(signed) {
    if (!signed) {
      record.replaceChildren(card("What is known", empty("Nothing yet: the camera is taken to be as it was drawn.")));
      return;
    }
    const { record: found } = signed;
    const number = (value, unit, scale) =>
      `${(scale * value.value).toPrecision(3)} ± ${(scale * value.uncertainty).toPrecision(2)} ${unit}`.trim();
    const rows = [
      ["Measured", day(found.taken_at)],
      ["Settling", number(found.settling_s, "ms", 1000)],
      ["Gain", number(found.gain, "", 1)],
      ["Gamma", number(found.gamma, "", 1)],
      ["Contrast floor", number(found.contrast_floor, "%", 100)],
      ["Stray light", number(found.stray_light, "%", 100)],
      ["Shift, down", number(found.shift_y_m, "µm", 1e6)],
      ["Shift, right", number(found.shift_x_m, "µm", 1e6)],
      ["Rotation", number(found.rotation_rad, "mrad", 1e3)],
      ["Distance error", number(found.distance_error_m, "µm", 1e6)],
      ["Dead rows and columns", String(found.dead_rows.length + found.dead_columns.length)],
      ["Error of what it predicts", `${(100 * found.psf_residual).toPrecision(2)} %`],
    ];
    record.replaceChildren(card("What is known", facts(rows)));
  }

  async function load() {
    const status = await get("/v1/calibration");
    show(status.signed);
    draw(status.run);
  }

  load().catch((error) => place.replaceChildren(empty(error.message)));
  return {
    elements: [columns([place], [record])],
    update(event) {
      if (event?.kind === "calibration") draw(event.run);
      else if (event?.kind === "gap") load().catch(() => {});
    },
  };
}
