// The failures as small pictures, by cluster.

const PAGE = window.innerWidth < 560 ? 8 : 24; // clusters that are shown at first
const BEFORE = 30; // m of road before the place of departure, as of a failure's segment
const repeatsById = new Map();

function repeatsOf(id) {
  return repeatsById.get(id) ?? null;
}

/** A button with a picture that opens a test. */
function card(id, order, { caption = "", small = false } = {}) {
  const test = tests.get(id);
  const drive = drives.get(id);
  const words = `Test ${id}, ${test.outcome}, MOOBD ${fixed(test.moobd, 2)} m${caption ? `: ${caption}` : ""}`;
  const repeats = repeatsOf(id);
  return el(
    "button",
    { type: "button", class: small ? "card small" : "card", "data-test": id, "aria-label": words, on: { click: () => player.open(id, order()) } },
    roadPicture(drive, ""),
    el("span", { class: "card-line" }, el("b", {}, `Test ${id}`), el("span", { class: `number outcome-${test.outcome.toLowerCase()}` }, fixed(test.moobd, 2, "m"))),
    repeats === null ? null : el("span", { class: `repeats ${repeats.stability}` }, `${repeats.stability}: ${percent(repeats.share)} fail (${fixed(100 * repeats.low, 0)}–${fixed(100 * repeats.high, 0)})`),
    caption ? el("span", { class: "card-text" }, caption) : null,
  );
}

/** What failures can be chosen by, per test: computed when it is first asked for. */
const traits = new Map();

function traitsOf(id) {
  if (!traits.has(id)) {
    const drive = drives.get(id);
    const records = recordsOf(drive);
    const place = drive.departure?.distance ?? drive.moobd_distance ?? 0;
    const then = drive.departure === null ? records.time[records.distance.findIndex((d) => d >= place)] ?? 0 : drive.departure.time;
    let sharpestBend = 0;
    for (let distance = Math.max(0, place - BEFORE); distance <= place; distance += 1) sharpestBend = Math.max(sharpestBend, Math.abs(curvatureAt(drive.road, distance)));
    traits.set(id, { radius: sharpestBend > 0 ? 1 / sharpestBend : Infinity, speed: 3.6 * momentAt(records, then).speed });
  }
  return traits.get(id);
}

/** Whether a text or number is found: "#47" and "47" are the id of a test, words are in any order. */
function isFound(query, cluster, id) {
  const number = query.match(/^#?(\d+)$/);
  if (number !== null) return id === Number(number[1]);
  const { operator, does } = tests.get(id);
  const text = `${cluster.description} ${drives.get(id).reason} ${operator} ${does}`.toLowerCase();
  return query.split(/\s+/).every((word) => text.includes(word));
}

/** Two fields for the least and the most of a quantity. */
function between(name, title, unit, explanation) {
  const field = (end, words) => el("input", { type: "number", id: `gallery-${name}-${end}`, class: "bound", min: 0, step: "any", inputmode: "decimal", "aria-label": `${title} ${words} (${unit})` });
  const [low, high] = [field("low", "from"), field("high", "to")];
  const isIn = (value) => (low.value === "" || value >= Number(low.value)) && (high.value === "" || value <= Number(high.value));
  const element = el("span", { title: explanation }, `${title} `, low, "–", high, ` ${unit}`);
  return { inputs: [low, high], element, isIn, isSet: () => low.value !== "" || high.value !== "" };
}

function drawGallery(element, block) {
  let shown = PAGE;
  let order = []; // the tests in sight
  let items = new Map(); // what a cluster's element says, as text -> the element
  const grid = el("div", { class: "gallery" });
  const more = el("button", { type: "button", class: "more" });
  const select = (id, options) => el("select", { id }, options.map(([value, text]) => el("option", { value }, text)));
  const sort = select("gallery-sort", [["moobd", "most severe"], ["size", "most alike"], ["first", "found first"]]);
  const side = select("gallery-side", [["", "either side"], ["left", "left"], ["right", "right"], ["none", "did not leave"]]);
  const search = el("input", { type: "search", id: "gallery-search", placeholder: "words or a test number", spellcheck: "false" });
  const radius = between("radius", "Radius", "m", `Smallest radius of the road in the ${BEFORE} m before the car left its lane`);
  const speed = between("speed", "Speed", "km/h", "Speed when the car left its lane");
  const robust = select("gallery-robust", [["", "any"], ["robust", "robust"], ["unclear", "unclear"], ["fragile", "fragile"], ["none", "not driven again"]]);
  const found = el("span", { role: "status", class: "found" });
  const clear = el("button", { type: "button" }, "Clear");
  const fields = [side, search, ...radius.inputs, ...speed.inputs, robust];

  const matches = (cluster, id) => {
    const query = search.value.trim().toLowerCase();
    return (
      (query === "" || isFound(query, cluster, id)) &&
      (!radius.isSet() || radius.isIn(traitsOf(id).radius)) &&
      (!speed.isSet() || speed.isIn(traitsOf(id).speed)) &&
      (robust.value === "" || (repeatsOf(id)?.stability ?? "none") === robust.value)
    );
  };
  const show = () => {
    const isFiltered = fields.some((field) => field.value !== "");
    const openable = block.clusters.filter((cluster) => cluster.shown.length);
    // A cluster is shown by its most severe failure that is asked for.
    const chosen = openable
      .filter((cluster) => side.value === "" || (cluster.side ?? "none") === side.value)
      .map((cluster) => ({ cluster, head: cluster.shown.find((id) => matches(cluster, id)) }))
      .filter(({ head }) => head !== undefined)
      .sort(({ cluster: a }, { cluster: b }) => (sort.value === "size" ? b.size - a.size : sort.value === "first" ? a.first - b.first : 0) || a.moobd - b.moobd);
    order = chosen.map(({ head }) => head);
    const [before, unfolded] = [items, [...grid.querySelectorAll(".is-open")].map((item) => item.dataset.first)];
    items = new Map();
    // An element that says the same is kept: with it what is unfolded, and no picture is drawn again.
    fillGrid(grid, more, chosen, shown, ({ cluster, head }) => {
      const text = JSON.stringify([cluster, head, block.repeats.length ? cluster.shown.map(repeatsOf) : null]);
      const known = before.get(text);
      const item = known ?? clusterItem(cluster, head, () => order);
      items.set(text, item);
      if (known === undefined && unfolded.includes(item.dataset.first)) item.querySelector("button.alike")?.click();
      return item;
    });
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
  const labelled = (text, field) => el("span", {}, el("label", { for: field.id }, text), field);
  for (const one of block.repeats) repeatsById.set(one.test, one);
  element.append(
    el(
      "div",
      { class: "choices" },
      labelled("First ", sort),
      labelled("Side ", side),
      labelled("Find ", search),
      radius.element,
      speed.element,
      block.repeats.length ? labelled("Driven again ", robust) : null,
      found,
      clear,
    ),
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
  const wanted = items.slice(0, shown).map(make);
  if (wanted.length !== grid.children.length || wanted.some((item, i) => item !== grid.children[i])) grid.replaceChildren(...wanted);
  more.hidden = items.length <= shown;
  more.textContent = `Show ${items.length - shown} more`;
  grid.querySelectorAll(".card").forEach((item, i) => (item.tabIndex = i === 0 ? 0 : -1));
}

function clusterItem(cluster, head, order) {
  const caption = head === cluster.most_severe ? cluster.description : `Like test ${cluster.most_severe}, which ${cluster.description}`;
  const item = el("article", { class: "cluster", "data-first": cluster.first }, card(head, order, { caption }));
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
