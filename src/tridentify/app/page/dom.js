// Elements made by hand: every name and number goes in as text, never as markup.

/** An element with attributes, listeners (`on`) and children; strings become text nodes. */
export function make(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) put(node, name, value);
  node.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
}

function put(node, name, value) {
  if (value === null || value === undefined || value === false) return;
  if (name === "on") {
    for (const [event, listener] of Object.entries(value)) node.addEventListener(event, listener);
  } else if (name === "value" || name === "checked" || name === "disabled") {
    node[name] = value;
  } else {
    node.setAttribute(name, value === true ? "" : String(value));
  }
}

export const byId = (id) => document.getElementById(id);

export function button(text, click, attributes = {}) {
  return make("button", { type: "button", on: { click }, ...attributes }, text);
}

/** A select of `choices` ([value, text] or value), one of them chosen. */
export function choice(choices, chosen, change, attributes = {}) {
  const pairs = choices.map((one) => (Array.isArray(one) ? one : [one, String(one)]));
  const options = pairs.map(([value, text]) =>
    make("option", { value, selected: String(value) === String(chosen) }, text));
  return make("select", { on: { change: (event) => change(event.target.value) }, ...attributes },
    options);
}

/** A name that may be broken after its commas. */
export const breakable = (text) =>
  text.split(/(?<=,)/).flatMap((part, at) => (at ? [make("wbr"), part] : [part]));

/** A table whose first column is text and whose others are numbers set as text. */
export function table(head, rows, attributes = {}) {
  const cell = (tag, text, column) =>
    make(tag, { class: column ? null : "text", scope: tag === "th" ? "col" : null }, text);
  return make("div", { class: "scroll", tabindex: "0", role: "region",
    "aria-label": attributes["aria-label"] ?? "table" },
    make("table", attributes,
      make("thead", {}, make("tr", {}, head.map((text, column) => cell("th", text, column)))),
      make("tbody", {}, rows.map((row) =>
        make("tr", {}, row.map((text, column) => cell("td", text, column)))))));
}

/** Puts `children` in place of what a node holds, and the focus where it was. */
export function fill(node, ...children) {
  const held = node.contains(document.activeElement) && document.activeElement !== node;
  const key = held ? document.activeElement.getAttribute("data-key") : null;
  node.replaceChildren(...children.flat().filter((child) => child));
  if (held) (keyed(node, key) ?? home(node))?.focus({ preventScroll: true });
}

const keyed = (node, key) =>
  (key === null ? null : node.querySelector(`[data-key="${CSS.escape(key)}"]:not(:disabled)`));

/** Where the focus goes when what had it is gone: the tab key goes on from there. */
function home(node) {
  const section = node.closest("section");
  if (section && !section.hasAttribute("tabindex")) section.setAttribute("tabindex", "-1");
  return section;
}
