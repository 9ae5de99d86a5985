// Data, elements, numbers, colours: what all parts of the page share.

const report = JSON.parse(document.getElementById("data").textContent);
const isEmbedded = report.replay !== undefined; // the page is one replay

/** Tests by id, from the columns of the page's table. */
const tests = new Map();
for (const [row, id] of (report.tests?.id ?? []).entries()) {
  tests.set(id, Object.fromEntries(Object.entries(report.tests).map(([name, values]) => [name, values[row]])));
}
const drives = new Map((report.drives ?? []).map((drive) => [drive.id, drive]));

// Elements. Texts become text nodes, never HTML.

const SVG_SPACE = "http://www.w3.org/2000/svg";

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "on") {
      for (const [event, listener] of Object.entries(value)) element.addEventListener(event, listener);
    } else if (value !== null && value !== undefined && value !== false) {
      element.setAttribute(name, value === true ? "" : String(value));
    }
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

function el(name, attributes = {}, ...children) {
  return fill(document.createElement(name), attributes, children);
}

function svg(name, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG_SPACE, name), attributes, children);
}

/** A field with its label. */
function labelled(text, field) {
  return el("span", {}, el("label", { for: field.id }, text), field);
}

/** Colours an element, and what it holds, by a colour of the style sheet. */
function tinted(name, element) {
  element.style.setProperty("--tint", `var(--${name})`);
  return element;
}

// Numbers as people read them, with a proper minus sign.

function fixed(value, digits, unit = "") {
  if (value === null || value === undefined) return "–";
  const text = value.toFixed(digits);
  // What rounds to zero has no sign.
  const sign = value < 0 && Number(text) !== 0 ? "−" : "";
  return sign + text.replace("-", "") + (unit && unit !== "°" ? "\u00a0" : "") + unit;
}

/** An oob distance beside the largest possible one, as `frenetic._support.words.oob_words` says it. */
function oobWords(oob) {
  return oob === null || oob < 0 ? fixed(oob, 2, "m") : `${fixed(oob, 2)} of ${fixed(report.lane_width / 2, 2, "m")}`;
}

function percent(share, digits = 0) {
  return share === null ? "–" : `${fixed(100 * share, digits)}\u00a0%`;
}

function count(number, what) {
  return number === 1 ? `1 ${what}` : `${number} ${what}s`;
}

function clamp(value, low, high) {
  return Math.min(Math.max(value, low), high);
}

/** The place of the last of ascending numbers that is not above a value; -1 if all are. */
function lastUpTo(numbers, value) {
  let [low, high] = [-1, numbers.length - 1];
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    if (numbers[middle] <= value) low = middle;
    else high = middle - 1;
  }
  return low;
}

// Light and dark

const THEMES = ["auto", "light", "dark"];

function storedTheme() {
  try {
    const name = localStorage.getItem("frenetic-theme");
    return THEMES.includes(name) ? name : "auto";
  } catch {
    return "auto"; // some browsers keep nothing for files
  }
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  try {
    localStorage.setItem("frenetic-theme", name);
  } catch {
    // It holds for this time only, then.
  }
}

/** Makes the page's address end so, where a viewer lets it. */
function setFragment(fragment) {
  try {
    history.replaceState(null, "", fragment || location.pathname + location.search);
  } catch {
    // Pages within other pages may have no address of their own.
  }
}

// Copying

function copyText(text) {
  if (navigator.clipboard && window.isSecureContext) {
    return navigator.clipboard.writeText(text).catch(() => copyBySelecting(text));
  }
  return Promise.resolve(copyBySelecting(text));
}

function copyBySelecting(text) {
  const area = el("textarea", { class: "off-screen", readonly: true });
  area.value = text;
  // Beside the button: a dialog lets nothing outside of it be selected.
  (document.querySelector("dialog[open]") ?? document.body).append(area);
  area.select();
  document.execCommand("copy");
  area.remove();
}

/** Lets a command line be copied by its button. */
function makeCopied(box) {
  const button = box.querySelector("button");
  button.addEventListener("click", async () => {
    await copyText(box.querySelector("code").textContent);
    button.textContent = "Copied";
    setTimeout(() => (button.textContent = "Copy"), 1500);
  });
}

function commandLine(line, text = "") {
  // Lines end between words, not within --options.
  const words = line.split(" ").flatMap((word, i) => [i ? " " : "", el("span", { class: "word" }, word)]);
  const box = el("div", { class: "command-line" }, el("code", {}, words), el("button", { type: "button", class: "copy" }, "Copy"));
  makeCopied(box);
  return el("div", { class: "command" }, text ? el("p", { class: "quiet" }, text) : null, box);
}

/** An element that scrolls sideways fades out where it goes on to the right. */
function scrollsSideways(element) {
  const fade = () => element.classList.toggle("goes-on", element.scrollLeft + element.clientWidth < element.scrollWidth - 2);
  element.addEventListener("scroll", fade, { passive: true });
  const watch = new ResizeObserver(fade);
  for (const one of [element, ...element.children]) watch.observe(one);
  return element;
}

/** Arrow keys move the focus among the elements that `find` gives, in rows as they are laid out. */
function arrowKeys(container, find) {
  container.addEventListener("keydown", (event) => {
    const items = find().filter((item) => item.offsetParent !== null);
    const at = items.indexOf(document.activeElement);
    if (at < 0) return;
    const next = neighbour(items, at, event.key);
    if (next === null) return;
    event.preventDefault();
    items.forEach((item) => (item.tabIndex = -1));
    items[next].tabIndex = 0;
    items[next].focus();
  });
}

function neighbour(items, at, key) {
  if (key === "ArrowRight") return Math.min(at + 1, items.length - 1);
  if (key === "ArrowLeft") return Math.max(at - 1, 0);
  if (key === "Home") return 0;
  if (key === "End") return items.length - 1;
  if (key !== "ArrowDown" && key !== "ArrowUp") return null;
  const here = items[at].getBoundingClientRect();
  const down = key === "ArrowDown";
  let best = null;
  let least = Infinity;
  items.forEach((item, i) => {
    const box = item.getBoundingClientRect();
    const ahead = down ? box.top - here.top : here.top - box.top;
    if (ahead <= 2) return;
    const cost = 1000 * ahead + Math.abs(box.left - here.left);
    if (cost < least) [best, least] = [i, cost];
  });
  return best;
}
