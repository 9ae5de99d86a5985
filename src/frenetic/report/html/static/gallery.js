// The failures as small pictures, by cluster.

const PAGE = window.innerWidth < 560 ? 8 : 24; // clusters that are shown at first
const repeats = new Map(); // test -> how it was driven again
const elsewhere = new Map(); // test -> how it was driven in other simulators

/** A button with a picture that opens a test. */
function card(id, order, { caption = "", small = false } = {}) {
  const test = tests.get(id);
  const drive = shortest(id);
  const isCut = drive !== drives.get(id);
  const title = `Test ${id}${isCut ? `, cut to ${fixed(roadLength(drive.road), 0, "m")}` : ""}`;
  const words = `${title}, ${test.outcome}, MOOBD ${oobWords(drive.moobd)}${caption ? `: ${caption}` : ""}`;
  const again = repeats.get(id);
  return el(
    "button",
    { type: "button", class: small ? "card small" : "card", "data-test": id, "aria-label": words, on: { click: () => player.open(id, order()) } },
    roadPicture(drive, ""),
    el("span", { class: "card-line" }, el("b", {}, title), el("span", { class: `number outcome-${test.outcome.toLowerCase()}` }, oobWords(drive.moobd))),
    again && el("span", { class: `repeats ${again.stability}` }, `${again.stability}: the same in ${percent(again.share)} (${fixed(100 * again.low, 0)}–${fixed(100 * again.high, 0)})`),
    caption ? el("span", { class: "card-text" }, caption) : null,
  );
}

/** Whether a text or number is found: "#47" and "47" are the id of a test, words are in any order. */
function isFound(query, cluster, id) {
  const number = query.match(/^#?(\d+)$/);
  if (number !== null) return id === Number(number[1]);
  const text = `${cluster.cause} ${shortest(id).happens} ${drives.get(id).reason} ${drives.get(id).origin}`.toLowerCase();
  return query.split(/\s+/).every((word) => text.includes(word));
}

function drawGallery(element, block) {
  let shown = PAGE;
  let order = []; // the tests in sight
  const grid = el("div", { class: "gallery" });
  const more = el("button", { type: "button", class: "more" });
  const select = (id, options) => el("select", { id }, options.map(([value, text]) => el("option", { value }, text)));
  const kinds = [...new Set(block.clusters.map((cluster) => cluster.group))].filter((text) => text);
  const sort = select("gallery-sort", [
    ...(kinds.length ? [["", "an example of each cause first"]] : []),
    ["moobd", "most severe first"], ["size", "most like it first"], ["first", "earliest found first"],
  ]);
  const cause = select("gallery-cause", [["", "any"], ...kinds.map((text) => [text, text])]);
  const side = select("gallery-side", [["", "either side"], ["left", "left"], ["right", "right"], ["none", "did not leave"]]);
  const search = el("input", { type: "search", id: "gallery-search", placeholder: "words or a test number", spellcheck: "false" });
  const robust = select("gallery-robust", [["", "any"], ["repeatable", "repeatable"], ["not repeatable", "not repeatable"], ["robust", "robust"], ["unclear", "unclear"], ["fragile", "fragile"], ["none", "not driven again"]]);
  const found = el("span", { role: "status", class: "found" });
  const clear = el("button", { type: "button" }, "Clear");
  const fields = [cause, side, search, robust];
  const openable = block.clusters.filter((cluster) => cluster.shown.length);
  for (const one of block.repeats) repeats.set(one.test, one);
  for (const one of block.elsewhere) elsewhere.set(one.test, [...(elsewhere.get(one.test) ?? []), one]);

  const show = () => {
    const isFiltered = fields.some((field) => field.value !== "");
    const query = search.value.trim().toLowerCase();
    const matches = (cluster, id) =>
      (query === "" || isFound(query, cluster, id)) && (robust.value === "" || (repeats.get(id)?.stability ?? "none") === robust.value);
    // A cluster is shown by its most severe failure that is asked for.
    const chosen = openable
      .filter((cluster) => cause.value === "" || cluster.group === cause.value)
      .filter((cluster) => side.value === "" || (cluster.side ?? "none") === side.value)
      .map((cluster) => ({ cluster, head: cluster.shown.find((id) => matches(cluster, id)) }))
      .filter(({ head }) => head !== undefined)
      .sort(({ cluster: a }, { cluster: b }) => sort.value === "size" ? b.size - a.size : sort.value === "first" ? a.first - b.first : sort.value === "moobd" ? a.moobd - b.moobd : 0);
    order = chosen.map(({ head }) => head);
    fillGrid(grid, more, chosen, shown, ({ cluster, head }) => clusterItem(cluster, head, () => order));
    if (!chosen.length) grid.append(el("p", { class: "quiet" }, "None of these."));
    found.textContent = isFiltered ? `${chosen.length} of ${openable.length}` : "";
    clear.hidden = !isFiltered;
  };
  more.addEventListener("click", () => {
    shown = Infinity;
    show();
  });
  clear.addEventListener("click", () => {
    for (const field of fields) field.value = "";
    show();
  });
  for (const field of [sort, ...fields]) field.addEventListener("input", show);
  element.append(
    el("div", { class: "choices" }, labelled("Order ", sort), kinds.length > 1 ? labelled("Cause ", cause) : null, labelled("Side ", side), labelled("Find ", search), block.repeats.length ? labelled("Driven again ", robust) : null, found, clear),
    grid,
    more,
    el("p", { class: "caption" }, oobKey()),
    el("p", { class: "caption" }, "Each road is laid flat and driven to the right; ● is its start, ○ where the car left its lane."),
  );
  arrowKeys(grid, () => [...grid.querySelectorAll(".card")]);
  show();
}

/** Fills a grid with so many of its items, and says on a button how many more there are. */
function fillGrid(grid, more, items, shown, make) {
  grid.replaceChildren(...items.slice(0, shown).map(make));
  more.hidden = items.length <= shown;
  more.textContent = `Show ${items.length - shown} more`;
  grid.querySelectorAll(".card").forEach((item, i) => (item.tabIndex = i === 0 ? 0 : -1));
}

function clusterItem(cluster, head, order) {
  const happens = `${shortest(head).happens}${cluster.was_known ? ", known before" : ""}`; // on the road in the picture
  const caption = cluster.cause ? `${cluster.cause}: ${happens}` : happens;
  const item = el("article", { class: "cluster" }, card(head, order, { caption }));
  const others = cluster.shown.filter((id) => id !== head);
  if (cluster.size > 1) {
    const hidden = cluster.size - cluster.shown.length;
    const text = `${cluster.size - 1} more like it`;
    if (!others.length) item.append(el("p", { class: "alike" }, `${text}, ${hidden === 1 ? "its drive is" : "their drives are"} not in this report`));
    else item.append(expander(text, others, hidden));
  }
  return item;
}

function expander(text, others, hidden) {
  const members = el("div", { class: "members", hidden: true });
  const button = el("button", { type: "button", class: "alike", "aria-expanded": "false" }, text);
  button.addEventListener("click", () => {
    const isOpen = button.getAttribute("aria-expanded") === "true";
    button.setAttribute("aria-expanded", String(!isOpen));
    members.hidden = isOpen;
    members.closest(".cluster").classList.toggle("is-open", !isOpen);
    if (!isOpen && !members.children.length) {
      members.append(...others.slice(0, 60).map((id) => card(id, () => others, { small: true })));
      const left = others.length - 60 + hidden;
      if (left > 0) members.append(el("p", { class: "quiet" }, `and ${left} more`));
    }
  });
  const box = document.createDocumentFragment();
  box.append(button, members);
  return box;
}
