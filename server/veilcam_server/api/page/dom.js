// Elements of the page. Text is only ever text: nothing that is told becomes markup.

export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(name, value);
    }
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

// Sets the text only where it differs, so that nothing is read aloud twice.
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

let cards = 0;

export function card(title, ...children) {
  const id = `card-${(cards += 1)}`;
  return h("section", { class: "card", "aria-labelledby": id }, h("h2", { id }, title), ...children);
}

// Columns side by side, where there is room for them; each has its own cards below one another.
export function columns(...groups) {
  return h(
    "div",
    { class: "columns" },
    groups.filter((cards) => cards.length).map((cards) => h("div", { class: "column" }, cards)),
  );
}

export const empty = (text) => h("p", { class: "empty" }, text);

// A button that does one thing at a time, and says why it could not.
export function button(text, work, { plain = false, ...attributes } = {}) {
  const element = h("button", { type: "button", class: plain ? "plain" : null, ...attributes }, text);
  element.addEventListener("click", () => busy(element, work));
  return element;
}

const wrong = (element) => {
  const place = element.closest(".card, dialog, form") ?? element.parentElement;
  let found = place.querySelector(":scope > .wrong");
  if (!found) {
    found = h("p", { class: "wrong", role: "alert" });
    place.append(found);
  }
  return found;
};

export async function busy(element, work) {
  if (element.getAttribute("aria-disabled") === "true") return;
  element.setAttribute("aria-disabled", "true");
  try {
    await work();
    wrong(element).remove();
  } catch (error) {
    say(wrong(element), error.message);
  } finally {
    element.removeAttribute("aria-disabled");
  }
}

// A form whose values `work` takes; `children` have named fields.
export function form(attributes, work, ...children) {
  const element = h("form", attributes, ...children);
  element.addEventListener("submit", (event) => {
    event.preventDefault();
    const sent = event.submitter ?? element.querySelector("[type=submit]");
    busy(sent, () => work(new FormData(element)));
  });
  return element;
}

let fields = 0;

export function field(label, input, note = null) {
  input.id ||= `field-${(fields += 1)}`;
  const told = note && h("span", { class: "note", id: `${input.id}-note` }, note);
  if (told) input.setAttribute("aria-describedby", told.id);
  return h("div", { class: "field" }, h("label", { for: input.id }, label), input, told);
}

// A secret that is shown once, with a button that copies it.
export function secretLine(text, words) {
  const line = h("code", {}, text);
  const told = h("p", { class: "note", role: "status" });
  const copy = button("Copy", async () => {
    // Browsers let pages that came by plain HTTP from another machine copy nothing by themselves.
    if (navigator.clipboard) await navigator.clipboard.writeText(text);
    else getSelection().selectAllChildren(line);
    say(told, navigator.clipboard ? "Copied." : "It is selected: copy it with the keyboard.");
  });
  return { elements: [h("p", {}, words), h("p", { class: "secret" }, line), told], copy };
}

export const facts = (pairs) =>
  h("dl", { class: "facts" }, pairs.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))));

export const fold = (title, ...children) => h("details", {}, h("summary", {}, title), ...children);

// A choice among few, of value, text and note: buttons, so that Tab and Space are all that it takes.
export function pick(legend, name, chosen, options, changed = () => {}) {
  const input = h("input", { type: "hidden", name, value: chosen });
  const buttons = options.map(([value, text]) =>
    h("button", { type: "button", class: "plain", "aria-pressed": String(value === chosen), onclick: press(value) }, text),
  );
  function press(value) {
    return ({ currentTarget }) => {
      input.value = value;
      for (const each of buttons) each.setAttribute("aria-pressed", each === currentTarget);
      changed(value);
    };
  }
  const rows = options.map(([, , note], index) => h("div", { class: "pick" }, buttons[index], note && h("span", { class: "note" }, note)));
  return h("fieldset", {}, h("legend", {}, legend), input, rows);
}

// Asks before what cannot be taken back.
export function confirmed(question, yes) {
  return new Promise((resolve) => {
    const dialog = h(
      "dialog",
      { "aria-labelledby": "question" },
      h("p", { id: "question" }, question),
      h(
        "p",
        { class: "row" },
        h("button", { type: "button", onclick: () => dialog.close("yes") }, yes),
        h("button", { type: "button", class: "plain", autofocus: true, onclick: () => dialog.close("") }, "Cancel"),
      ),
    );
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(dialog.returnValue === "yes");
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}
