// What a simulated camera looks at, and what is wrong with it.

import { put, remove } from "./api.js";
import { button, busy, card, field, fold, h, say } from "./dom.js";

const SIDE = 28;
const ROWS = 4;
const FAULTS = [
  ["The panel loses its power", { panel: { dead: true } }],
  ["The panel is unplugged", { panel: { gone: true } }],
  ["The panel is stuck", { panel: { stuck: true } }],
  ["The panel's window is open", { panel: { open_window: true } }],
  ["The panel shows light for dark", { panel: { inverted: true } }],
  ["The panel fell asleep", { panel: { asleep: true } }],
  ["The panel loses every 9th transfer", { panel: { lost: 9 } }],
  ["The panel takes half a mask", { panel: { half: true } }],
  ["The panel shows masks elsewhere", { panel: { shifted: true } }],
  ["Light comes past the mask", { light: { bypass: 0.2 } }],
  ["The lamp is off", { light: { lamp: 0 } }],
  ["The sensor is unplugged", { sensor: { gone: true } }],
  ["The sensor gives no frame", { sensor: { silent: true } }],
];

export function sceneCards(camera) {
  if (!camera.status.device.simulated || !camera.may("simulate")) return [];
  return [{ element: sceneCard() }];
}

let sheet = null;

async function digits() {
  sheet ??= new Promise((resolve, reject) => {
    const image = new Image();
    image.addEventListener("load", () => resolve(image));
    image.addEventListener("error", () => reject(new Error("The digits could not be loaded.")));
    image.src = new URL("digits.png", import.meta.url).href;
  });
  return sheet;
}

const canvas = () => h("canvas", { width: SIDE, height: SIDE, "aria-hidden": "true" });
const bytes = (picture) => new Promise((resolve) => picture.toBlob(resolve, "image/png"));

async function digit(label) {
  const image = await digits();
  const picture = canvas();
  const row = Math.floor(Math.random() * ROWS);
  picture.getContext("2d").drawImage(image, SIDE * label, SIDE * row, SIDE, SIDE, 0, 0, SIDE, SIDE);
  return picture;
}

function sceneCard() {
  const told = h("p", { class: "note", role: "status" });
  const buttons = new Map();

  async function hold(name, body, type) {
    await put("/v1/simulation/scene", body, { type });
    for (const [each, element] of buttons) element.setAttribute("aria-pressed", each === name);
    say(told, `It looks at ${name}.`);
  }

  for (let label = 0; label < 10; label += 1) {
    const name = `a ${label}`;
    const element = button("", async () => hold(name, await bytes(await digit(label)), "image/png"), {
      class: "digit",
      "aria-label": `Hold up ${name}`,
      "aria-pressed": "false",
    });
    const picture = canvas();
    digits().then((image) =>
      picture.getContext("2d").drawImage(image, SIDE * label, 0, SIDE, SIDE, 0, 0, SIDE, SIDE),
    ).catch(() => {}); // who presses the button is told
    element.append(picture);
    buttons.set(name, element);
  }
  const nothing = button("Nothing", async () => {
    const black = canvas();
    black.getContext("2d").fillRect(0, 0, SIDE, SIDE);
    await hold("nothing", await bytes(black), "image/png");
  }, { plain: true, "aria-pressed": "false" });
  buttons.set("nothing", nothing);
  const away = button("Reset scene", async () => {
    await remove("/v1/simulation/scene");
    for (const element of buttons.values()) element.setAttribute("aria-pressed", "false");
    say(told, "It looks at what it was started with.");
  }, { plain: true });
  const file = h("input", { type: "file", accept: "image/png,image/jpeg,image/webp,image/bmp,image/tiff,image/gif" });
  file.addEventListener("change", () => {
    const [chosen] = file.files;
    if (chosen) busy(file, () => hold("a picture of yours", chosen, chosen.type));
  });
  return card(
    "Scene",
    h("p", { class: "note" }, "This camera is simulated. Choose what is in front of it."),
    h("div", { class: "digits", role: "group", "aria-label": "Digits" }, [...buttons.values()].slice(0, 10)),
    h("p", { class: "row" }, nothing, away),
    field("Or a picture of yours", file),
    told,
    fold("Faults", faults()),
  );
}

function faults() {
  const told = h("p", { class: "note", role: "status" }, "Nothing is broken.");
  const chosen = h("select", {}, FAULTS.map(([text], index) => h("option", { value: index }, text)));
  return h(
    "div",
    { class: "column" },
    h("p", { class: "note" }, "Break the simulated camera, and see what it says."),
    field("What happens", chosen),
    h(
      "p",
      { class: "row" },
      button("Break it", async () => {
        const [text, faults] = FAULTS[chosen.value];
        await put("/v1/simulation/faults", faults);
        say(told, `${text}.`);
      }, { plain: true }),
      button("Mend it", async () => {
        await put("/v1/simulation/faults", {});
        say(told, "Nothing is broken.");
      }, { plain: true }),
    ),
    told,
  );
}
