// The failures as small pictures, by cluster.

const PAGE = window.innerWidth < 560 ? 8 : 24; // clusters that are shown at first
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

function drawGallery(element, block) {
  for (const one of block.repeats) repeatsById.set(one.test, one);
  let shown = PAGE;
  const grid = el("div", { class: "gallery" });
  const more = el("button", { type: "button", class: "more" });
  const sort = el(
    "select",
    { id: "gallery-sort" },
    [["moobd", "most severe"], ["size", "most alike"], ["first", "found first"]].map(([value, text]) => el("option", { value }, text)),
  );
  const side = el(
    "select",
    { id: "gallery-side" },
    [["", "either side"], ["left", "left"], ["right", "right"], ["none", "did not leave"]].map(([value, text]) => el("option", { value }, text)),
  );

  const show = () => {
    const chosen = block.clusters
      .filter((cluster) => cluster.shown.length && (side.value === "" || (cluster.side ?? "none") === side.value))
      .sort((a, b) => (sort.value === "size" ? b.size - a.size : sort.value === "first" ? a.first - b.first : 0) || a.moobd - b.moobd);
    const order = () => chosen.map((cluster) => cluster.shown[0]);
    grid.replaceChildren(...chosen.slice(0, shown).map((cluster) => clusterItem(cluster, order)));
    if (!chosen.length) grid.append(el("p", { class: "quiet" }, "None of these."));
    more.hidden = chosen.length <= shown;
    more.textContent = `Show ${chosen.length - shown} more`;
    setRoving(grid);
  };
  more.addEventListener("click", () => {
    shown = Infinity;
    show();
  });
  sort.addEventListener("change", show);
  side.addEventListener("change", show);
  element.append(
    el("div", { class: "choices" }, el("span", {}, el("label", { for: "gallery-sort" }, "First "), sort), el("span", {}, el("label", { for: "gallery-side" }, "Side "), side)),
    grid,
    more,
    el("p", { class: "caption" }, oobKey(), ". Each road is laid flat and driven to the right; ● is its start, ○ where the car left its lane."),
  );
  arrowKeys(grid, () => [...grid.querySelectorAll(".card")]);
  show();
}

function setRoving(grid) {
  grid.querySelectorAll(".card").forEach((item, i) => (item.tabIndex = i === 0 ? 0 : -1));
}

function clusterItem(cluster, order) {
  const first = cluster.shown[0];
  const item = el("article", { class: "cluster" }, card(first, order, { caption: cluster.description }));
  const others = cluster.shown.slice(1);
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
